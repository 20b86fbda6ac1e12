"""Reading a job now and then for many who watch it: one reading serves them all."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final, Protocol

from anyio import CapacityLimiter, Lock, to_thread

from app.engine import Job
from app.errors import TooManyRequests

INTERVAL_S: Final = 0.2
"""Between two readings of one job: nobody reads more than five events a second."""


class Described(Protocol):
    """A job as it is answered: a model of the wire."""

    @property
    def state(self) -> str:
        """One of the states of `JobRow`."""

    @property
    def total(self) -> int:
        """How many frames there are to work on."""

    @property
    def done(self) -> int:
        """How many of them are done."""

    @property
    def finished(self) -> bool:
        """True when nothing will happen to it any more."""

    def model_dump_json(self) -> str:
        """As it is written into an answer."""


@dataclass
class _Watched:
    """A job that somebody watches; `seen` is None once it was deleted."""

    watchers: int = 0
    at: float = float("-inf")
    seen: Described | None = None
    lock: Lock = field(default_factory=Lock)


class Poller:
    """The newest state of each job that is watched; belongs to one event loop.

    Watchers hold no thread and no connection between two readings, and reading has a
    thread of its own: those that requests share may all be waiting for a transaction.
    """

    def __init__(self, most: int, most_of_one: int) -> None:
        self._most = most
        self._most_of_one = most_of_one
        self._by_token: Counter[int] = Counter()
        self._watched: dict[Job, _Watched] = {}
        self._thread = CapacityLimiter(1)

    @property
    def watchers(self) -> int:
        """How many watch a job."""
        return sum(each.watchers for each in list(self._watched.values()))

    @contextmanager
    def watching(self, job: Job, token_id: int) -> Iterator[None]:
        """Keep what is read of this job for as long as the block lasts.

        Raises
        ------
        TooManyRequests
            As many watch already as may at the same time, by all tokens or by this.
        """
        if self._by_token[token_id] >= self._most_of_one:
            raise TooManyRequests(
                f"{self._most_of_one} streams of this token are open already; close one"
            )
        if self.watchers >= self._most:
            raise TooManyRequests(f"{self._most} streams are open already; try later")
        watched = self._watched.setdefault(job, _Watched())
        watched.watchers += 1
        self._by_token[token_id] += 1
        try:
            yield
        finally:
            watched.watchers -= 1
            self._by_token[token_id] -= 1
            if not self._by_token[token_id]:
                del self._by_token[token_id]
            if not watched.watchers:
                del self._watched[job]

    async def newest(
        self, job: Job, read: Callable[[Job], Described | None]
    ) -> Described | None:
        """What `read` finds now, or found within the last interval."""
        watched = self._watched[job]
        async with watched.lock:
            if time.monotonic() - watched.at >= INTERVAL_S:
                watched.seen = await to_thread.run_sync(read, job, limiter=self._thread)
                watched.at = time.monotonic()
        return watched.seen
