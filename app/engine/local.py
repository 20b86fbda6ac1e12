"""The embedded engine: it executes jobs and chunks in threads of this process."""

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
"""Items in progress per worker: enough to keep it busy, few enough for memory."""
CHUNK_FRAMES: Final = 200
"""Frames in a chunk; all threads measure it, and it is stored in small steps."""

log = logging.getLogger(__name__)


_here: Final = threading.local()


class _Lane:
    """Threads that drive jobs, and one for the chunks of these jobs.

    In the former, `_here.lane` is this lane.
    """

    def __init__(self, drivers: int, suffix: str = "") -> None:
        enter = partial(setattr, _here, "lane", self)
        self.jobs = ThreadPoolExecutor(drivers, f"jobs{suffix}", enter)
        self.chunks = ThreadPoolExecutor(1, f"chunks{suffix}")


class LocalEngine:
    """The embedded engine: threads, most of which wait for a child process.

    A child decodes and measures a frame (`app.engine.children`). Small plain frames
    are measured in the thread itself; zlib and OpenCV release Python's global lock.
    Long jobs have threads of their own, so that no short one waits for them.

    `ClusterEngine` overrides the methods for chunks (`start_chunk`, `outcome` and so
    on) to process them on other machines.
    """

    def __init__(self, workers: int, drivers: int = 1) -> None:
        self.workers = workers
        self._pixels: Executor = ThreadPoolExecutor(workers, "pixels")
        self._short, self._long = _Lane(drivers), _Lane(drivers, "-long")
        self._queued: set[Job] = set()
        self.stopping = Stop()
        self._busy = 0
        self._counting = threading.Lock()
        self._unwanted: set[Job] = set()
        self._done: dict[Job, int] = {}

    def start(self, work: Callable[[_Item], _Result], item: _Item) -> Future[_Result]:
        """Start `work` on one item in the thread pool."""

        def counted() -> _Result:
            with self._counting:
                self._busy += 1
            try:
                return work(item)
            finally:
                with self._counting:
                    self._busy -= 1

        return self._pixels.submit(counted)

    @property
    def busy(self) -> int:
        """How many items are being worked on."""
        return self._busy

    def map(
        self,
        work: Callable[[_Item], _Result],
        items: Iterable[_Item],
        *,
        one_by_one: bool = False,
    ) -> Generator[_Result, None, None]:
        """Results in the order of the items, with a limited number in progress.

        If the service stops, only items that have begun give results. With
        `one_by_one`, an item begins when the caller requests its result.
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
                if not self.stopping.is_set():
                    waiting.extend(self.start(work, item) for item in islice(source, 1))
        finally:
            # If the caller stops early, the remaining items are not needed.
            for future in waiting:
                future.cancel()

    def submit(
        self, work: Callable[[], None], job: Job | None = None, *, is_long: bool = False
    ) -> None:
        """Queue a job; a failure is logged. A job that is queued already is skipped."""
        lane = self._long if is_long else self._short
        if job is None:
            lane.jobs.submit(_logging_failures, work)
            return
        with self._counting:
            if job in self._queued:
                return
            self._queued.add(job)

        def begin() -> None:
            with self._counting:
                self._queued.discard(job)
            work()

        lane.jobs.submit(_logging_failures, begin)

    @property
    def most_in_flight(self) -> int:
        """How many chunks of a job may be in progress at the same time."""
        return 2

    def chunk_frames(self, total: int) -> int:
        """How many frames a chunk has, in a job of `total` frames."""
        return CHUNK_FRAMES

    def start_chunk(self, here: ChunkWork, job: Job, number: int) -> Future[str]:
        """Start a chunk of a job; `here` processes it in this process."""
        lane: _Lane = getattr(_here, "lane", self._short)
        return lane.chunks.submit(here, job.kind, job.id, number)

    def outcome(self, future: Future[str]) -> str:
        """How a chunk ended.

        Raises, only in a cluster, WorkerDied if the worker's process ended or reported
        no outcome, and EngineAway if the chunk has to be submitted again.
        """
        return future.result()

    def release(self, futures: Iterable[Future[str]]) -> None:
        """Cancel chunks; waits for those that have begun in this process."""
        for future in futures:
            if not future.cancel():
                wait([future])

    def is_connected(self) -> bool:
        """Whether the engine is connected, and has not lost submitted chunks."""
        return True

    def connect(self) -> None:
        """Connect to the engine again; raises EngineAway if it does not respond."""

    def interrupt(self, job: Job) -> None:
        """Stop a job that is being cancelled, before its row says so.

        A job in its last step holds the turn to write, so that the cancellation could
        be written to its row only afterwards.
        """
        self._unwanted.add(job)

    def clear_cancel(self, job: Job) -> None:
        """Undo `interrupt`: by now the job's row says whether it is cancelled."""
        self._unwanted.discard(job)

    def interrupted(self) -> frozenset[Job]:
        """Jobs that are being cancelled."""
        return frozenset(self._unwanted)

    def check(self, job: Job) -> None:
        """Raise `JobStopped` if the service is stopping or the job being cancelled."""
        if self.stopping.is_set():
            raise JobStopped(job)
        self.check_wanted(job)

    def check_wanted(self, job: Job) -> None:
        """Raise `JobStopped` only if the job is being cancelled."""
        if job in self._unwanted:
            raise JobStopped(job)

    def report(self, job: Job, done: int) -> None:
        """Store progress of a job in memory that its row does not have yet."""
        self._done[job] = done

    def reported(self, job: Job) -> int:
        """The last reported progress; 0 for finished jobs and other processes' jobs."""
        return self._done.get(job, 0)

    def clear_progress(self, job: Job) -> None:
        """Forget the progress: by now the job's row has it."""
        self._done.pop(job, None)

    def close(self) -> None:
        """Tell all jobs to stop, and wait for the running ones."""
        if not self.stopping.is_set():
            self.stopping.set()
        # A job that is found to be long goes from the short lane to the long one.
        for lane in (self._short, self._long):
            lane.jobs.shutdown(cancel_futures=True)
            lane.chunks.shutdown(cancel_futures=True)
        self._pixels.shutdown(cancel_futures=True)


def _logging_failures(work: Callable[[], None]) -> None:
    try:
        work()
    except Exception:
        log.exception("a job failed")
