"""Where work runs: threads for pixels, jobs one after the other, chunks of jobs here
or on other machines."""

from __future__ import annotations

from app.engine.jobs import (
    EngineAway,
    JobStopped,
    Stop,
    UnusableEngine,
    WorkerDied,
)
from app.engine.local import LocalEngine
from app.jobs import Job

__all__ = [
    "EngineAway",
    "Job",
    "JobStopped",
    "LocalEngine",
    "Stop",
    "UnusableEngine",
    "WorkerDied",
]
