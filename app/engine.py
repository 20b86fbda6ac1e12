"""Where work runs: threads for pixels, one after the other for jobs."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from itertools import islice
from typing import Final, TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

WINDOW: Final = 4
"""Tasks in flight per worker: enough to keep it busy, few enough to hold in memory."""

log = logging.getLogger(__name__)


class LocalEngine:
    """The embedded engine. OpenCV lets go of the interpreter: threads suffice."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pixels: Executor = ThreadPoolExecutor(workers, "pixels")
        self._jobs = ThreadPoolExecutor(1, "jobs")
        self.stopping = threading.Event()

    def map(
        self, work: Callable[[_Item], _Result], items: Iterable[_Item]
    ) -> Iterator[_Result]:
        """Results in the order of the items, a bounded number of them in flight."""
        source = iter(items)
        waiting: list[Future[_Result]] = [
            self._pixels.submit(work, item)
            for item in islice(source, self.workers * WINDOW)
        ]
        while waiting:
            yield waiting.pop(0).result()
            for item in islice(source, 1):
                waiting.append(self._pixels.submit(work, item))

    def submit(self, job: Callable[[], None]) -> None:
        """Run a job after those that wait already; its failure ends only itself."""
        self._jobs.submit(_guarded, job)

    def close(self) -> None:
        """Let the running job notice, then wait for it."""
        self.stopping.set()
        self._jobs.shutdown(cancel_futures=True)
        self._pixels.shutdown(cancel_futures=True)


def _guarded(job: Callable[[], None]) -> None:
    try:
        job()
    except Exception:
        log.exception("a job failed")
