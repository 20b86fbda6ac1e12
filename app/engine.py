"""Where work runs: threads for pixels, one after the other for jobs."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import Final, NamedTuple, TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

WINDOW: Final = 4
"""Tasks in flight per worker: enough to keep it busy, few enough to hold in memory."""

log = logging.getLogger(__name__)


class JobStopped(Exception):
    """The service stops, or nobody wants the job any more: it ends here, quietly."""


class Job(NamedTuple):
    """A run or an export, by its number."""

    kind: str
    id: int


class Stop:
    """Whether the service stops; who waits for something else is told at once."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._told: list[Callable[[], None]] = []

    def is_set(self) -> bool:
        """True from the moment on at which the service was asked to stop."""
        return self._event.is_set()

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


class LocalEngine:
    """The embedded engine. OpenCV lets go of the interpreter: threads suffice."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pixels: Executor = ThreadPoolExecutor(workers, "pixels")
        self._jobs = ThreadPoolExecutor(1, "jobs")
        self.stopping = Stop()
        self._busy = 0
        self._counting = threading.Lock()
        self._unwanted: set[Job] = set()
        self._done: dict[Job, int] = {}

    def start(self, work: Callable[[_Item], _Result], item: _Item) -> Future[_Result]:
        """Work on one item beside everything else that is measured."""
        return self._pixels.submit(self._worked, work, item)

    @property
    def busy(self) -> int:
        """How many threads work on an item right now."""
        return self._busy

    def _worked(self, work: Callable[[_Item], _Result], item: _Item) -> _Result:
        with self._counting:
            self._busy += 1
        try:
            return work(item)
        finally:
            with self._counting:
                self._busy -= 1

    def map(
        self, work: Callable[[_Item], _Result], items: Iterable[_Item]
    ) -> Generator[_Result, None, None]:
        """Results in the order of the items, a bounded number of them in flight.

        They end early when the service stops: what was begun is given, the rest is not.
        """
        source = iter(items)
        waiting: list[Future[_Result]] = [
            self.start(work, item) for item in islice(source, self.workers * WINDOW)
        ]
        try:
            while waiting:
                future = waiting.pop(0)
                if self.stopping.is_set() and future.cancel():
                    continue
                yield future.result()
                for item in () if self.stopping.is_set() else islice(source, 1):
                    waiting.append(self.start(work, item))
        finally:
            # Nobody will ask for what is left when a job ends early.
            for future in waiting:
                future.cancel()

    def submit(self, work: Callable[[], None]) -> None:
        """Run a job after those that wait already; its failure ends only itself."""
        self._jobs.submit(_guarded, work)

    def interrupt(self, job: Job) -> None:
        """Let a job notice that it is unwanted, before any row can tell it.

        A job that is storing its end holds the database's only place for writers: who
        cancels it could not write that down before it is over.
        """
        self._unwanted.add(job)

    def let_be(self, job: Job) -> None:
        """From now on the job's row alone says whether it is wanted."""
        self._unwanted.discard(job)

    def interrupted(self) -> frozenset[Job]:
        """Jobs that somebody is about to cancel."""
        return frozenset(self._unwanted)

    def check(self, job: Job) -> None:
        """Raise `JobStopped` where a job that goes on would work in vain."""
        if self.stopping.is_set():
            raise JobStopped(job)
        self.check_wanted(job)

    def check_wanted(self, job: Job) -> None:
        """Raise `JobStopped` only if nobody wants what the job has done so far."""
        if job in self._unwanted:
            raise JobStopped(job)

    def report(self, job: Job, done: int) -> None:
        """Say how far a job is while its transaction is open: no row can tell yet."""
        self._done[job] = done

    def reported(self, job: Job) -> int:
        """What `report` said last; 0 for jobs of other processes and finished ones."""
        return self._done.get(job, 0)

    def over(self, job: Job) -> None:
        """Forget what was reported: the job's row says it all."""
        self._done.pop(job, None)

    def close(self) -> None:
        """Let the running job notice, then wait for it."""
        if not self.stopping.is_set():
            self.stopping.set()
        self._jobs.shutdown(cancel_futures=True)
        self._pixels.shutdown(cancel_futures=True)


def _guarded(work: Callable[[], None]) -> None:
    try:
        work()
    except Exception:
        log.exception("a job failed")
