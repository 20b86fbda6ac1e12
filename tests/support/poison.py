"""Frames, decisions and exports of which the process dies that works on them.

Frames say "poison" in their annotation; of decisions that store something, and of
exports, it is every one. To be laid in processes of the tests' own, before these begin
to work.
"""

from __future__ import annotations

import os
import signal
import time
from typing import Any

from app.measuring.frame_files import measure_files

FRAMES, DECISIONS, EXPORTS = "frames", "decisions", "exports"


def lay_poison(kind: str = FRAMES) -> None:
    """Let this process die where it would do such a thing."""
    {
        FRAMES: _lay_in_frames,
        DECISIONS: _lay_in_decisions,
        EXPORTS: _lay_in_exports,
    }[kind]()


def _lay_in_frames() -> None:
    from app.runs import measure as run_measuring

    measure = measure_files

    def deadly(pool: Any, plan: Any, annotation: Any, files: Any) -> Any:
        if "poison" in annotation.raw:
            _die()
        return measure(pool, plan, annotation, files)

    vars(run_measuring)["measure_files"] = deadly


def _lay_in_decisions() -> None:

    def deadly(*_: Any) -> Any:
        _die()

    from app.runs.queries import RunRepository

    type.__setattr__(RunRepository, "record_flips", deadly)


def _lay_in_exports() -> None:
    from app.exports import writer as export_writing

    def deadly(*_: Any) -> Any:
        _die()

    vars(export_writing)["write_export"] = deadly


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(60)  # until the signal is there, nothing more happens


if __name__ == "__main__":
    from app.serve import serve
    from app.settings import Settings

    lay_poison()
    serve(Settings())
