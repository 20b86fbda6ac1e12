"""Executes work: pixels in threads and child processes, jobs one after the other, and
chunks of jobs in this process or on other machines."""

from __future__ import annotations

from app.engine.chunk import (
    EngineAway,
    Job,
    JobStopped,
    Stop,
    UnusableEngine,
    WorkerDied,
)
from app.engine.local import LocalEngine

__all__ = [
    "EngineAway",
    "Job",
    "JobStopped",
    "LocalEngine",
    "Stop",
    "UnusableEngine",
    "WorkerDied",
]
