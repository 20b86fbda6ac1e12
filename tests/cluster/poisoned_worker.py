"""A worker whose process dies of frames whose annotation says "poison".

Without arguments it is the one that starts such processes, as `unghost worker` is.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

from app import worker
from app.logs import configure_logging
from app.services import measuring, run_measuring
from app.settings import Settings

MODULE = "tests.cluster.poisoned_worker"


def lay_poison() -> None:
    """Let the process die where it would measure such a frame."""
    measure = measuring.measure_files

    def deadly(plan: Any, annotation: Any, files: Any) -> Any:
        if "poison" in annotation.raw:
            os.kill(os.getpid(), signal.SIGKILL)
        return measure(plan, annotation, files)

    vars(run_measuring)["measure_files"] = deadly


if __name__ == "__main__":
    if sys.argv[1:]:
        lay_poison()
        sys.exit(worker.main())
    settings = Settings()
    configure_logging(settings.log_level, settings.log_format)
    sys.exit(worker.Supervisor(settings, worker.Place(), MODULE).run())
