"""A worker whose process kills itself at poisoned pictures (`tests.support.poison`).

Without arguments this is the supervisor that starts such processes, as
`unghost worker` does; with arguments it is one of them.
"""

import sys

from app.logs import configure_logging
from app.process import worker
from app.settings import Settings
from tests.support.poison import lay_poison

MODULE = "tests.support.poisoned_worker"

if __name__ == "__main__":
    if sys.argv[1:]:
        lay_poison()
        sys.exit(worker.main())
    settings = Settings()
    configure_logging(settings.log_level, settings.log_format)
    sys.exit(worker.Supervisor(settings, worker.WorkerEndpoint(), MODULE).run())
