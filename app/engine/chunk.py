"""Types of all engines: jobs, how chunks end, errors, and the signal to stop."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

DONE: Final = "done"
RETURNED: Final = "returned"
"""It is to be tried again: the process that worked on it stops, or the database was
away."""
FAILED: Final = "failed"
"""The chunk's row has the error that its job is to fail with."""
UNWANTED: Final = "unwanted"
"""Its job is over, cancelled or deleted: nobody wants the result any more."""
QUARANTINED: Final = "quarantined"
"""Its process has died too often: it is not tried again."""
ELSEWHERE: Final = "elsewhere"
"""The worker uses another database."""

ChunkWork = Callable[[str, int, int], str]
"""Works on a chunk, given the kind and id of its job and its number; how it ended."""


class JobStopped(Exception):
    """The service stops, or the job was cancelled: it ends here without an error."""


class WorkerDied(Exception):
    """A process ended while it worked on a chunk, or could not say how that ended."""


class EngineAway(Exception):
    """The engine has forgotten what was submitted, or cannot be reached."""


class UnusableEngine(Exception):
    """The engine of the settings cannot be used; the text says why."""


class Stop:
    """Whether the service stops; it can call functions at that moment."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._callbacks: list[Callable[[], None]] = []

    def is_set(self) -> bool:
        """Whether the service was asked to stop."""
        return self._event.is_set()

    def wait(self, seconds: float) -> bool:
        """Wait until it is to stop, at most so many seconds; returns whether it is."""
        return self._event.wait(seconds)

    def set(self) -> None:
        """Ask the service to stop, and call the registered functions in this thread."""
        self._event.set()
        for call in list(self._callbacks):
            call()

    @contextmanager
    def calling(self, call: Callable[[], None]) -> Iterator[None]:
        """Have `call` called if the service is asked to stop while the block runs."""
        self._callbacks.append(call)
        try:
            yield
        finally:
            self._callbacks.remove(call)


class Job(NamedTuple):
    """A run or an export, by its number."""

    kind: str
    id: int
