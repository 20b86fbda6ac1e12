"""The embedded engine: threads of this process, and no other process."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from functools import partial
from itertools import islice
from typing import Final, TypeVar

from app.engine.chunk import ChunkWork, Job, JobStopped, Stop

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

WINDOW: Final = 4
"""Tasks in flight per worker: enough to keep it busy, few enough to hold in memory."""
CHUNK_FRAMES: Final = 200
"""Frames of a chunk here: it uses all threads, and is stored bit by bit."""

log = logging.getLogger(__name__)


class LocalEngine:
    """The embedded engine. OpenCV lets go of the interpreter: threads suffice.

    `start_chunk`, `outcome` and what stands beside them are the seam behind which
    chunks may also run on other machines (`ClusterEngine`).
    """

    def __init__(self, workers: int, drivers: int = 1) -> None:
        self.workers = workers
        self._pixels: Executor = ThreadPoolExecutor(workers, "pixels")
        self._jobs = ThreadPoolExecutor(drivers, "jobs")
        self._chunks = ThreadPoolExecutor(1, "chunks")
        self._queued: set[Job] = set()
        self.stopping = Stop()
        self._busy = 0
        self._counting = threading.Lock()
        self._unwanted: set[Job] = set()
        self._done: dict[Job, int] = {}

    def start(self, work: Callable[[_Item], _Result], item: _Item) -> Future[_Result]:
        """Work on one item at the same time as others are measured."""
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
        self,
        work: Callable[[_Item], _Result],
        items: Iterable[_Item],
        *,
        one_by_one: bool = False,
    ) -> Generator[_Result, None, None]:
        """Results in the order of the items, a bounded number of them in flight.

        They end early when the service stops: what was begun is given, the rest is not.
        One by one, an item is begun when the result before it has been dealt with.
        """
        source = iter(items)
        window = 1 if one_by_one else self.workers * WINDOW
        waiting: list[Future[_Result]] = [
            self.start(work, item) for item in islice(source, window)
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

    def submit(self, work: Callable[[], None], job: Job | None = None) -> None:
        """Run a job after those that wait already; its failure ends only itself.

        One that waits is not queued once more.
        """
        if job is None:
            self._jobs.submit(_guarded, work)
            return
        with self._counting:
            if job in self._queued:
                return
            self._queued.add(job)
        self._jobs.submit(_guarded, partial(self._begin, work, job))

    def _begin(self, work: Callable[[], None], job: Job) -> None:
        with self._counting:
            self._queued.discard(job)
        work()

    @property
    def window(self) -> int:
        """How many chunks of a job may be in flight."""
        return 2

    def chunk_frames(self, total: int) -> int:
        """How many frames of so many a chunk is to have."""
        return CHUNK_FRAMES

    def start_chunk(self, here: ChunkWork, job: Job, number: int) -> Future[str]:
        """Begin to work on a chunk; only strings and integers say which."""
        return self._chunks.submit(here, job.kind, job.id, number)

    def outcome(self, future: Future[str]) -> str:
        """How a chunk ended.

        Raises
        ------
        WorkerDied
            Its process ended, or could not say; never in this process.
        EngineAway
            It has to be submitted again; never in this process.
        """
        return future.result()

    def release(self, futures: Iterable[Future[str]]) -> None:
        """Nobody waits for these chunks any more: those that were begun here end."""
        for future in futures:
            if not future.cancel():
                wait([future])

    def is_connected(self) -> bool:
        """Whether what was submitted is known to whoever is to do it."""
        return True

    def connect(self) -> None:
        """Reach the engine again.

        Raises
        ------
        EngineAway
            It does not answer; the text says more.
        """

    def interrupt(self, job: Job) -> None:
        """Tell a job that it is being cancelled, before its row can say so.

        On SQLite a job that stores its end holds the database's only place for writers.
        Whoever cancels it could write that down only after its end.
        """
        self._unwanted.add(job)

    def clear_cancel(self, job: Job) -> None:
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

    def clear_progress(self, job: Job) -> None:
        """Forget what was reported: the job's row says it all."""
        self._done.pop(job, None)

    def close(self) -> None:
        """Let the running job notice, then wait for it."""
        if not self.stopping.is_set():
            self.stopping.set()
        self._jobs.shutdown(cancel_futures=True)
        self._chunks.shutdown(cancel_futures=True)
        self._pixels.shutdown(cancel_futures=True)


def _guarded(work: Callable[[], None]) -> None:
    try:
        work()
    except Exception:
        log.exception("a job failed")
