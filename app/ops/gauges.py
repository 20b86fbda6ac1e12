"""How many files are stored, and how large they are: the one sum that takes time."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from sqlalchemy.exc import SQLAlchemyError

from app.context import ServiceContext
from app.db.engine import Database
from app.engine import LocalEngine
from app.ingest.batch import OpenBatches
from app.jobs.events import Poller
from app.jobs.kind import kinds
from app.logs import error_log
from app.metrics import Gauge
from app.ops.queries import BlobTotals, Totals
from filter_core.types import Reason

LEAST_PAUSE_S: Final = 60
MOST_OF_A_THREAD: Final = 0.01
"""The share of one thread that counting blobs may take."""


class BlobCount:
    """The blobs as they were counted last; counted in the background, now and then."""

    def __init__(self) -> None:
        self._newest: BlobTotals | None = None
        self._next_at = float("-inf")

    def newest(self, database: Database, engine: LocalEngine) -> BlobTotals | None:
        """What is known; None until the first count is over."""
        if time.monotonic() >= self._next_at and not engine.stopping.is_set():
            self._next_at = float("inf")
            engine.start(self._count, database)
        return self._newest

    def _count(self, database: Database) -> None:
        begun = time.monotonic()
        try:
            with database.read() as session:
                self._newest = Totals(session).blobs()
        except SQLAlchemyError as exc:
            error_log.warning("the blobs cannot be counted", exc_info=exc)
        now = time.monotonic()
        pause = max(LEAST_PAUSE_S, (now - begun) / MOST_OF_A_THREAD)
        self._next_at = now + pause


def gauges(context: ServiceContext) -> Iterator[Gauge]:
    """What is looked up when somebody asks, and not counted as it happens."""
    yield from _of_threads(context)
    yield from _of_disk(context)
    try:
        found = list(_of_database(context))
    except SQLAlchemyError as exc:
        error_log.warning("the database cannot be asked for figures", exc_info=exc)
        found = []
    up = Gauge.of("unghost_database_up", "1 if the database answers.", bool(found))
    yield from (up, *found)
    counted = context.one(BlobCount).newest(context.database, context.engine)
    if counted is not None:
        yield Gauge.of("unghost_blobs", "Files stored, counted lately.", counted.files)
        text = "Bytes of all stored files, counted lately."
        yield Gauge.of("unghost_blob_bytes", text, counted.size_bytes)


def _of_threads(context: ServiceContext) -> Iterator[Gauge]:
    engine = context.engine
    yield Gauge.of("unghost_workers", "Threads that measure pixels.", engine.workers)
    yield Gauge.of("unghost_workers_busy", "Those that measure now.", engine.busy)
    open_now = context.one(OpenBatches).open
    yield Gauge.of("unghost_batches_open", "Batches being received.", open_now)
    text = "Bytes of requests that are in memory."
    yield Gauge.of("unghost_open_body_bytes", text, context.bodies.open_bytes)
    watching = context.one(Poller).watchers
    yield Gauge.of("unghost_event_streams_open", "Watchers of runs.", watching)
    text = "1 once the service was asked to stop."
    yield Gauge.of("unghost_stopping", text, engine.stopping.is_set())


def _of_disk(context: ServiceContext) -> Iterator[Gauge]:
    disk = shutil.disk_usage(context.settings.data)
    yield Gauge.of("unghost_disk_bytes", "Size of the data folder's disk.", disk.total)
    yield Gauge.of("unghost_disk_free_bytes", "Room left on it.", disk.free)
    least = int(context.settings.min_free_bytes)
    yield Gauge.of("unghost_disk_min_free_bytes", "Room that it needs.", least)
    file = context.database.file
    if file is not None:
        yield Gauge.of("unghost_database_bytes", "Size of the database.", _size(file))
        wal = file.with_name(f"{file.name}-wal")
        yield Gauge.of("unghost_wal_bytes", "Size of the write-ahead log.", _size(wal))


def _of_database(context: ServiceContext) -> Iterator[Gauge]:
    with context.database.read() as session:
        totals = Totals(session)
        datasets = totals.datasets()
        yield Gauge.of("unghost_datasets", "Datasets that there are.", datasets)
        jobs = totals.jobs(kind.table for kind in kinds()).items()
        yield Gauge(
            "unghost_jobs",
            "Runs and exports by state; queued and running ones are the queue.",
            [({"kind": kind, "state": state}, count) for (kind, state), count in jobs],
        )
        yield _of_verdicts(totals.boxes_by_reason())
        answers = totals.boxes_by_review().items()
        yield Gauge(
            "unghost_boxes_reviewed",
            "Boxes by the answer that stands.",
            [({"verdict": verdict}, boxes) for verdict, boxes in answers],
        )
        if context.database.file is None:
            size = totals.database_bytes()
            yield Gauge.of("unghost_database_bytes", "Size of the database.", size)


def _of_verdicts(boxes_by_reason: dict[int, int]) -> Gauge:
    reasons = {Reason(number): boxes for number, boxes in boxes_by_reason.items()}
    return Gauge(
        "unghost_boxes",
        "Boxes by the decision that stands.",
        [
            ({"verdict": reason.verdict.value, "reason": reason.label}, boxes)
            for reason, boxes in reasons.items()
        ],
    )


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except FileNotFoundError:
        return 0
