"""The engine for several machines: workers of a Dask scheduler process the chunks.

Uploads are still measured in this process, and jobs are driven from here. If the
cluster loses chunks, they are submitted again: the database records which are done.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from app.engine.chunk import ChunkWork, EngineAway, Job, WorkerDied
from app.engine.dask import Certificates, prepare, security
from app.engine.local import LocalEngine
from app.logs import server_log

if TYPE_CHECKING:
    from distributed import Client

DRIVERS: Final = 4
"""Jobs that are driven at the same time; other machines do the work."""
MOST_IN_FLIGHT: Final = 256
PER_WORKER: Final = 4
"""Chunks in progress per worker; a job is divided into as many per worker."""
FEWEST_FRAMES, MOST_FRAMES = 20, 500
_ANSWER_S: Final = 3
COUNTED_FOR_S: Final = 2.0
LOG_AGAIN_S: Final = 60.0


@dataclass(frozen=True)
class Scheduler:
    """The scheduler's address, certificates for it, and its workers' installation."""

    address: str
    certificates: Certificates
    installation: str


class AbsenceLog:
    """Decides when to log that something is absent: at once, then at intervals."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._logged_at = clock, -math.inf

    def is_due(self, *, absent: bool) -> bool:
        """Whether to log it, given whether it is absent now."""
        if not absent:
            self._logged_at = -math.inf
            return False
        is_due = self._clock() - self._logged_at >= LOG_AGAIN_S
        if is_due:
            self._logged_at = self._clock()
        return is_due


class ClusterEngine(LocalEngine):
    """Executes the chunks of jobs on workers of a cluster.

    Everything else happens in this process, as in `LocalEngine`.
    """

    def __init__(self, workers: int, scheduler: Scheduler) -> None:
        prepare()
        encrypted = scheduler.address.startswith("tls://")
        self._security = security(scheduler.certificates, encrypted=encrypted)
        super().__init__(workers, DRIVERS)
        self._scheduler = scheduler
        self._client: Client | None = None
        self._connecting = threading.Lock()
        self._counted = (0.0, 0)
        self._absence = AbsenceLog()

    @property
    def most_in_flight(self) -> int:
        """How many chunks of a job may be in progress, up to `MOST_IN_FLIGHT`."""
        return min(MOST_IN_FLIGHT, PER_WORKER * max(1, self._worker_count()))

    def chunk_frames(self, total: int) -> int:
        """Frames per chunk: few enough that every worker gets several short chunks."""
        share = total // (PER_WORKER * max(1, self._worker_count()))
        return max(FEWEST_FRAMES, min(MOST_FRAMES, share))

    def start_chunk(self, here: ChunkWork, job: Job, number: int) -> Future[str]:
        """Send a chunk to a worker; `here` is not used."""
        client = self._client
        if client is None:
            raise EngineAway("not connected")
        executor = client.get_executor(pure=False)
        try:
            sent: Future[str] = executor.submit(
                run_on_worker, job.kind, job.id, number, self._scheduler.installation
            )
        except Exception as exc:
            raise EngineAway(str(exc)) from exc
        return sent

    def outcome(self, future: Future[str]) -> str:
        """How a chunk ended, by the worker's report."""
        try:
            return future.result()
        except CancelledError as exc:
            raise EngineAway("the scheduler lost the submitted chunks") from exc
        except Exception as exc:
            raise WorkerDied(str(exc) or type(exc).__name__) from exc

    def release(self, futures: Iterable[Future[str]]) -> None:
        """Cancel chunks; workers end running ones when they see the cancelled job."""
        for future in futures:
            future.cancel()

    def is_connected(self) -> bool:
        """Whether the scheduler is connected."""
        return self._client is not None and self._client.status == "running"

    def connect(self) -> None:
        """Connect to the scheduler; raises EngineAway if it does not respond."""
        from distributed import Client

        with self._connecting:
            if self.is_connected():
                return
            self._disconnect()
            try:
                self._client = Client(
                    self._scheduler.address,
                    security=self._security,
                    timeout=_ANSWER_S,
                    set_as_default=False,
                    name="unghost",
                )
            except Exception as exc:
                raise EngineAway(f"{self._scheduler.address}: {exc}") from exc
        server_log.info("connected to the scheduler at %s", self._scheduler.address)

    def close(self) -> None:
        """Stop driving jobs; the workers finish the chunks that they have begun."""
        super().close()
        self._disconnect()

    def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with suppress(Exception):  # the connection may be lost already
                client.close(timeout=_ANSWER_S)

    def _worker_count(self) -> int:
        """How many workers there are; cached for `COUNTED_FOR_S` seconds."""
        until, workers = self._counted
        if self._client is None or time.monotonic() < until:
            return workers
        try:
            workers = len(self._client.nthreads(callback_timeout=_ANSWER_S))
        except Exception:  # the connection was lost: `start_chunk` will raise
            workers = 0
        if self._absence.is_due(absent=not workers):
            server_log.warning("no worker has joined %s", self._scheduler.address)
        self._counted = (time.monotonic() + COUNTED_FOR_S, workers)
        return workers


RemoteWork = Callable[[str, int, int, str], str]

_WORK: Final[list[RemoteWork]] = []


def work_with(work: RemoteWork) -> None:
    """Set the function that processes chunks; workers call this before they join."""
    _WORK[:] = [work]


def run_on_worker(kind: str, job_id: int, number: int, installation: str) -> str:
    """Process a chunk on a worker, with the function set by `work_with`.

    `installation` is the id of the job's database. Returns an outcome, one of the
    constants of `app.engine.chunk`.
    """
    if not _WORK:
        raise RuntimeError("this process is not a worker of Unghost")
    return _WORK[0](kind, job_id, number, installation)
