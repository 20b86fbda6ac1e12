"""Gauges for Prometheus that are read on request; slow ones are cached."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from prometheus_client.core import GaugeMetricFamily as Gauge
from sqlalchemy.exc import SQLAlchemyError

from app.context import ServiceContext
from app.db.engine import Database
from app.engine.local import LocalEngine
from app.incoming import OpenBodies
from app.ingest.batch import OpenBatches
from app.jobs.events import Poller
from app.jobs.kind import kinds
from app.logs import error_log
from app.ops.queries import Totals
from filter_core.verdicts import Reason

LEAST_PAUSE_S: Final = 60
MOST_OF_A_THREAD: Final = 0.01
"""The share of one thread that counting blobs may take."""


class BlobCount:
    """The last count of blobs; it is repeated in the background at intervals."""

    def __init__(self) -> None:
        self._newest: tuple[int, int] | None = None
        self._next_at = float("-inf")

    def newest(self, database: Database, engine: LocalEngine) -> tuple[int, int] | None:
        """The last count; None until the first one has ended."""
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
            error_log.warning("cannot count the stored files", exc_info=exc)
        now = time.monotonic()
        pause = max(LEAST_PAUSE_S, (now - begun) / MOST_OF_A_THREAD)
        self._next_at = now + pause


def gauges(context: ServiceContext) -> Iterator[Gauge]:
    """The metrics whose values are read for each request of Prometheus."""
    engine, disk = context.engine, shutil.disk_usage(context.settings.data)
    file, least = context.database.file, int(context.settings.min_free_bytes)
    batches, bodies = context.one(OpenBatches).open, context.one(OpenBodies).open_bytes
    is_stopping = engine.stopping.is_set()
    for name, text, value in (
        ("unghost_workers", "Threads that measure pixels.", engine.workers),
        ("unghost_workers_busy", "Threads that measure pixels now.", engine.busy),
        ("unghost_batches_open", "Batches being received.", batches),
        ("unghost_open_body_bytes", "Bytes of requests that are in memory.", bodies),
        (
            "unghost_event_streams_open",
            "Open streams of events of runs and exports.",
            context.one(Poller).watchers,
        ),
        ("unghost_stopping", "1 if the service is stopping, else 0.", is_stopping),
        ("unghost_disk_bytes", "Size of the data folder's disk.", disk.total),
        ("unghost_disk_free_bytes", "Free space on the data folder's disk.", disk.free),
        (
            "unghost_disk_min_free_bytes",
            "Free space below which frames are refused.",
            least,
        ),
    ):
        yield Gauge(name, text, value)
    if file is not None:
        yield Gauge("unghost_database_bytes", "Size of the database.", _size(file))
        wal = file.with_name(f"{file.name}-wal")
        yield Gauge("unghost_wal_bytes", "Size of the write-ahead log.", _size(wal))
    try:
        of_database = list(_of_database(context))
    except SQLAlchemyError as exc:
        error_log.warning("cannot read metrics from the database", exc_info=exc)
        of_database = []
    text = "1 if the database responds, else 0."
    yield from (Gauge("unghost_database_up", text, bool(of_database)), *of_database)
    counted = context.one(BlobCount).newest(context.database, context.engine)
    if counted is not None:
        files, size_bytes = counted
        text = "Stored files, counted at most once a minute."
        yield Gauge("unghost_blobs", text, files)
        text = "Bytes of all stored files, counted at most once a minute."
        yield Gauge("unghost_blob_bytes", text, size_bytes)


def _of_database(context: ServiceContext) -> Iterator[Gauge]:
    with context.database.read() as session:
        totals = Totals(session)
        yield Gauge("unghost_datasets", "Existing datasets.", totals.datasets())
        text = "Runs and exports by state; queued and running ones are the queue."
        jobs = Gauge("unghost_jobs", text, labels=("kind", "state"))
        for kind_and_state, count in totals.jobs(
            kind.table for kind in kinds()
        ).items():
            jobs.add_metric(kind_and_state, count)
        yield jobs
        text = "Boxes by their current decision."
        decided = Gauge("unghost_boxes", text, labels=("verdict", "reason"))
        for number, boxes in totals.boxes_by_reason().items():
            reason = Reason(number)
            decided.add_metric((reason.verdict.value, reason.label), boxes)
        yield decided
        text = "Boxes by their current answer."
        reviewed = Gauge("unghost_boxes_reviewed", text, labels=("verdict",))
        for verdict, boxes in totals.boxes_by_review().items():
            reviewed.add_metric((verdict,), boxes)
        yield reviewed
        if context.database.file is None:
            size = totals.database_bytes()
            yield Gauge("unghost_database_bytes", "Size of the database.", size)


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except FileNotFoundError:
        return 0
