"""Types shared by all engines: jobs, outcomes of chunks, errors, the stop signal."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

DONE: Final = "done"
RETURNED: Final = "returned"
"""It has to be retried: the process that worked on it is stopping, or the database was
unavailable."""
FAILED: Final = "failed"
"""Its job has to fail, with the error in the chunk's row."""
UNWANTED: Final = "unwanted"
"""Its job is finished, cancelled or deleted: the result is not needed any more."""
QUARANTINED: Final = "quarantined"
"""It is in quarantine (`app.jobs.attempts`), and was not worked on."""
ELSEWHERE: Final = "elsewhere"
"""The worker uses another database."""

ChunkWork = Callable[[str, int, int], str]
"""Processes a chunk, given its job's kind and id and its number; the outcome."""


class JobStopped(Exception):
    """This process stops working on a job, without an error.

    The service is stopping, another process drives the job, or the job has ended, was
    cancelled or deleted.
    """


class WorkerDied(Exception):
    """A process ended while it worked on a chunk, or reported no outcome."""


class EngineAway(Exception):
    """The engine has lost the submitted chunks, or cannot be reached."""


class UnusableEngine(Exception):
    """The engine of the settings cannot be used; the text says why."""


class Stop:
    """The stop signal of the service, with callbacks."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._callbacks: list[Callable[[], None]] = []

    def is_set(self) -> bool:
        """Whether the service has been told to stop."""
        return self._event.is_set()

    def wait(self, seconds: float) -> bool:
        """Wait for the stop signal, at most so many seconds; returns `is_set`."""
        return self._event.wait(seconds)

    def set(self) -> None:
        """Set the stop signal, and call the registered functions in this thread."""
        self._event.set()
        for call in list(self._callbacks):
            call()

    @contextmanager
    def calling(self, call: Callable[[], None]) -> Iterator[None]:
        """Call `call` if the service is told to stop while the block runs."""
        self._callbacks.append(call)
        try:
            yield
        finally:
            self._callbacks.remove(call)


class Job(NamedTuple):
    """The identity of a job: `kind` is "run" or "export"."""

    kind: str
    id: int
