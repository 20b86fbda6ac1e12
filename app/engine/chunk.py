"""What a job is called, how its chunks end, and what can go wrong with an engine."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

DONE: Final = "done"
RETURNED: Final = "returned"
"""The process that worked on it stops: somebody else is to go on."""
FAILED: Final = "failed"
"""Why is in the chunk's row."""
UNWANTED: Final = "unwanted"
QUARANTINED: Final = "quarantined"
"""It has ended its process too often: nobody is to try it again."""
ELSEWHERE: Final = "elsewhere"
"""Whoever was asked looks at another database."""

ChunkWork = Callable[[str, int, int], str]
"""Works on a chunk: kind and id of its job, its number; how it ended."""


class JobStopped(Exception):
    """The service stops, or nobody wants the job any more: it ends here, quietly."""


class WorkerDied(Exception):
    """A process ended while it worked on a chunk, or could not say how that ended."""


class EngineAway(Exception):
    """The engine has forgotten what was submitted, or cannot be reached."""


class UnusableEngine(Exception):
    """The engine of the settings cannot be used; the text says why."""


class Stop:
    """Whether the service stops; who waits for something else is told at once."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._told: list[Callable[[], None]] = []

    def is_set(self) -> bool:
        """True from the moment on at which the service was asked to stop."""
        return self._event.is_set()

    def wait(self, seconds: float) -> bool:
        """Wait until it is to stop, but not longer; whether it is."""
        return self._event.wait(seconds)

    def set(self) -> None:
        """It is to stop. Called by the thread of those who want to be told."""
        self._event.set()
        for tell in list(self._told):
            tell()

    @contextmanager
    def telling(self, tell: Callable[[], None]) -> Iterator[None]:
        """Call this when the service stops, for as long as the block lasts."""
        self._told.append(tell)
        try:
            yield
        finally:
            self._told.remove(tell)


class Job(NamedTuple):
    """A run or an export, by its number."""

    kind: str
    id: int
