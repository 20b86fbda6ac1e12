"""The engine for several machines: workers that joined a scheduler do the chunks.

Uploads are still measured here, and jobs are driven here. What the cluster forgets or
delays does no harm: the chunks are kept in the database.
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
"""Jobs that are driven at the same time: the work is elsewhere."""
MOST_IN_FLIGHT: Final = 256
PER_PLACE: Final = 4
"""Chunks in flight for each worker, and into which its share of a job is cut."""
FEWEST_FRAMES, MOST_FRAMES = 20, 500
_ANSWER_S: Final = 3
COUNTED_FOR_S: Final = 2.0
TELL_AGAIN_S: Final = 60.0


@dataclass(frozen=True)
class Scheduler:
    """Where it listens, what is shown to it, and whose database its workers share."""

    address: str
    certificates: Certificates
    installation: str


class Absence:
    """Something is not there: worth a word when it begins, and once in a while."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._told_at = clock, -math.inf

    def is_news(self, *, absent: bool) -> bool:
        """Whether to say so, of what somebody has just looked at."""
        if not absent:
            self._told_at = -math.inf
            return False
        is_due = self._clock() - self._told_at >= TELL_AGAIN_S
        if is_due:
            self._told_at = self._clock()
        return is_due


class ClusterEngine(LocalEngine):
    """As `LocalEngine`, with the chunks of jobs on workers."""

    def __init__(self, workers: int, scheduler: Scheduler) -> None:
        prepare()
        encrypted = scheduler.address.startswith("tls://")
        self._security = security(scheduler.certificates, encrypted=encrypted)
        super().__init__(workers, DRIVERS)
        self._scheduler = scheduler
        self._client: Client | None = None
        self._connecting = threading.Lock()
        self._counted = (0.0, 0)
        self._absence = Absence()

    @property
    def window(self) -> int:
        """How many chunks of a job may be in flight: bounded, however many workers."""
        return min(MOST_IN_FLIGHT, PER_PLACE * max(1, self._places()))

    def chunk_frames(self, total: int) -> int:
        """So many that every worker gets some, and none is at it for long."""
        share = total // (PER_PLACE * max(1, self._places()))
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
        """How a chunk ended, as the worker says."""
        try:
            return future.result()
        except CancelledError as exc:
            raise EngineAway("the scheduler lost what was submitted") from exc
        except Exception as exc:
            raise WorkerDied(str(exc) or type(exc).__name__) from exc

    def release(self, futures: Iterable[Future[str]]) -> None:
        """Workers notice in the job's row that nobody wants it, or end their chunk."""
        for future in futures:
            future.cancel()

    def is_connected(self) -> bool:
        """Whether the scheduler is there."""
        return self._client is not None and self._client.status == "running"

    def connect(self) -> None:
        """Reach the scheduler, anew if it went away."""
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
        """Stop driving; the workers finish what they have begun."""
        super().close()
        self._disconnect()

    def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with suppress(Exception):  # who is away need not be told
                client.close(timeout=_ANSWER_S)

    def _places(self) -> int:
        """How many workers there are, as of a moment ago."""
        until, places = self._counted
        if self._client is None or time.monotonic() < until:
            return places
        try:
            places = len(self._client.nthreads(callback_timeout=_ANSWER_S))
        except Exception:  # it went away just now: whoever submits will see
            places = 0
        if self._absence.is_news(absent=not places):
            server_log.warning("no worker has joined %s", self._scheduler.address)
        self._counted = (time.monotonic() + COUNTED_FOR_S, places)
        return places


RemoteWork = Callable[[str, int, int, str], str]

_WORK: Final[list[RemoteWork]] = []


def work_with(work: RemoteWork) -> None:
    """Say how this process works on chunks; a worker does so before it joins."""
    _WORK[:] = [work]


def run_on_worker(kind: str, job_id: int, number: int, installation: str) -> str:
    """What a worker is sent: work on a chunk with the function of `work_with`.

    `installation` is the id of the database that the job is in. The result is a word of
    `app.engine.chunk`.
    """
    if not _WORK:
        raise RuntimeError("this process is no worker of Unghost")
    return _WORK[0](kind, job_id, number, installation)
