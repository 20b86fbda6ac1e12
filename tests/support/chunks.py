"""Engines that work in small chunks, some of which fail, and checks of their runs."""

import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, TypeVar

from sqlalchemy import select

from app.db.tables import FrameEvidence, Run
from app.engine.chunk import EngineAway, WorkerDied
from app.engine.local import LocalEngine
from app.jobs.queries import job_with_id
from tests.support import frames as scene

T = TypeVar("T")

FRAMES = 12
FROM_PIXELS = {"profile": "carlasimu"}


class SmallChunks(LocalEngine):
    """An engine with three frames in a chunk that works on several chunks at once."""

    def __init__(self) -> None:
        super().__init__(2)
        self._threads = ThreadPoolExecutor(4, "chunks")
        self.begun: list[tuple[int, frozenset[int]]] = []
        self._running: set[int] = set()
        self._changing = threading.Lock()

    @property
    def most_in_flight(self):
        return 4

    def chunk_frames(self, total):
        return 3

    def start_chunk(self, here, job, number):
        with self._changing:
            self._running.add(number)
            self.begun.append((number, frozenset(self._running)))
        return self.run_later(self._work, here, job, number)

    def run_later(self, call: Callable[..., T], *arguments: Any) -> Future[T]:
        """Call it in one of the threads that work on chunks."""
        return self._threads.submit(call, *arguments)

    def _work(self, here, job, number):
        try:
            return here(job.kind, job.id, number)
        finally:
            with self._changing:
                self._running.discard(number)

    def outcome(self, future):
        return future.result()

    def close(self):
        self._threads.shutdown(cancel_futures=True)
        super().close()


class CrashingEngine(SmallChunks):
    """An engine whose worker dies of the `poison` chunks.

    A chunk fails if it is poisoned, or if it begins while a poisoned one is running.
    Each poisoned chunk itself fails at most `times` times.
    """

    def __init__(self, *poison: int, times: int = 99) -> None:
        super().__init__()
        self._poison, self._times = set(poison), Counter(dict.fromkeys(poison, times))

    def _work(self, here, job, number):
        try:
            with self._changing:
                beside = self._poison & self._running
                deadly = any(self._times[chunk] > 0 for chunk in beside)
                self._times[number] -= deadly
            if deadly:
                raise WorkerDied(f"chunk {number} was there")
            return here(job.kind, job.id, number)
        finally:
            with self._changing:
                self._running.discard(number)


class DisconnectingEngine(SmallChunks):
    """An engine that loses its connection, and the chunk, at every third start."""

    def __init__(self) -> None:
        super().__init__()
        self.connected, self.connects = True, 0

    def start_chunk(self, here, job, number):
        if len(self.begun) % 3 == 2:
            self.begun.append((number, frozenset()))
            self.connected = False
            lost: Future[str] = Future()
            lost.cancel()
            return lost
        if not self.connected:
            raise EngineAway("gone")
        return super().start_chunk(here, job, number)

    def outcome(self, future):
        try:
            return future.result()
        except CancelledError as exc:
            raise EngineAway("forgotten") from exc

    def is_connected(self):
        return self.connected

    def connect(self):
        self.connects += 1
        if self.connects % 2:
            raise EngineAway("not yet")
        self.connected = True


def put(street, number):
    files = {"image": scene.image(number), "segmentation": scene.segmentation()}
    street.put(f"{number:02}", scene.annotation(), **files)


@contextmanager
def context_with_engine(street, engine):
    context = replace(street.context, engine=engine)
    try:
        yield context
    finally:
        engine.close()


def run_of(street, run_id):
    return read(street, lambda session: job_with_id(session, Run, run_id))


def read(street, ask):
    with street.context.database.read() as session:
        return ask(session)


def measured(street, run):
    """Count how often each frame was measured for a run."""
    rows = select(FrameEvidence.frame_id)
    rows = rows.where(FrameEvidence.measurement_id == run.measurement_id)
    return Counter(read(street, lambda session: session.scalars(rows).all()))


def remaining_rows(street, table, run):
    rows = select(table).where(table.kind == "run", table.job_id == run.id)
    return read(street, lambda session: session.scalars(rows).all())


def check_run_is_complete(street, run):
    assert (run.state, run.done, run.total) == ("done", FRAMES, FRAMES), run.error
    assert set(measured(street, run).values()) == {1}
    assert len(measured(street, run)) == FRAMES
    assert street.tallies() == street.recounted()
