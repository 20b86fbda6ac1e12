"""Writing an export: one consistent view of the database, streamed into one file.

The file is named by its content, and the same state gives the same bytes. An export
that was cut off is written anew: what is there of it belongs to a state that is gone.
"""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.tables import Dataset, Export
from app.engine import Job, JobStopped
from app.errors import AppError
from app.repositories.datasets import DatasetRepository
from app.repositories.frames import FrameRepository
from app.repositories.reviews import ReviewRepository
from app.repositories.runs import ExportRepository
from app.repositories.tallies import TallyRepository
from app.services.configs import active_version
from app.services.context import ServiceContext
from app.services.export_archive import ReproducibleZip
from app.services.export_frames import ExportFrames
from filter_core.errors import FilterError
from filter_core.formats.export_frame import ExportFrame, ExportHead
from filter_core.formats.export_options import ExportOptions
from filter_core.formats.writers import write_export

OPEN: Final = ("queued", "running")
TELL_EVERY_S: Final = 0.5

log = logging.getLogger(__name__)


def job_of(export_id: int) -> Job:
    """The job that writes an export."""
    return Job("export", export_id)


def start_exports(context: ServiceContext) -> None:
    """Queue every export that is not finished; one that was cut off starts anew."""
    with context.database.read() as session:
        waiting = [export.id for export in ExportRepository(session).unfinished()]
    for export_id in waiting:
        context.engine.submit(partial(make_export, context, export_id))


def make_export(context: ServiceContext, export_id: int) -> None:
    """Write one export from its row to its end; safe to call again after a crash."""
    try:
        _begin(context, export_id)
        _write(context, export_id)
    except JobStopped:
        return
    except (AppError, FilterError) as error:
        log.warning("export %d failed: %s", export_id, error)
        _fail(context, export_id, {"code": error.kind, "detail": error.detail})
    except Exception:
        unexpected = {"code": "internal", "detail": "the export failed"}
        if _fail(context, export_id, unexpected):
            raise
        # Somebody cancelled it, or deleted its dataset, between two statements.
        log.info("export %d ended: nobody wants it any more", export_id)


def _begin(context: ServiceContext, export_id: int) -> None:
    with context.database.write() as session:
        export = _at_work(session, export_id)
        export.state, export.done = "running", 0
        export.total = FrameRepository(session).count(export.dataset_id)


def _at_work(session: Session, export_id: int) -> Export:
    export = ExportRepository(session).find(export_id)
    if export is None or export.state not in OPEN:
        raise JobStopped(job_of(export_id))
    return export


def _write(context: ServiceContext, export_id: int) -> None:
    with _empty_folder(context, export_id) as folder:
        file = folder / "export.zip"
        with context.database.stream() as session:
            export = _at_work(session, export_id)
            counts = _stream(context, session, export, file)
        size_bytes = file.stat().st_size
        digest = context.storage.adopt(file)
    with context.database.write() as session:
        export = _at_work(session, export_id)
        context.storage.require([digest])
        export.state, export.finished_at = "done", utc_now()
        export.sha256, export.size_bytes = digest, size_bytes
        export.counts, export.done = counts, export.total


@contextmanager
def _empty_folder(context: ServiceContext, export_id: int) -> Iterator[Path]:
    """A place for one export; what a crash left there before is removed."""
    folder = context.storage.temporary_folder() / f"export-{export_id}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _stream(
    context: ServiceContext, session: Session, export: Export, file: Path
) -> dict[str, Any]:
    dataset = DatasetRepository(session).with_id(export.dataset_id)
    frames = ExportFrames(context, session, dataset)
    head = replace(_head(session, dataset), temporary=file.parent)
    with ReproducibleZip(file) as archive:
        options = ExportOptions.from_mapping(export.options)
        coming = _told(context, export.id, frames)
        return write_export(export.format, coming, archive.add, head, options)


def _head(session: Session, dataset: Dataset) -> ExportHead:
    tallies = TallyRepository(session).of_dataset(dataset.id)
    return ExportHead(
        classes=tuple(DatasetRepository(session).classes(dataset.id)),
        facts={
            "dataset": dataset.name,
            "run": dataset.active_run_id,
            "config": active_version(session, dataset).digest,
            "last_review": ReviewRepository(session).last_id(dataset.id),
            "frames": FrameRepository(session).count(dataset.id),
        },
        expected_boxes=sum(tallies.values()),
    )


def _told(
    context: ServiceContext, export_id: int, frames: ExportFrames
) -> Iterator[ExportFrame]:
    """The frames, telling now and then how many have passed; the job can end here."""
    told = time.monotonic()
    for done, frame in enumerate(frames):
        context.engine.check(job_of(export_id))
        if time.monotonic() - told >= TELL_EVERY_S:
            _tell(context, export_id, done)
            told = time.monotonic()
        yield frame


def _tell(context: ServiceContext, export_id: int, done: int) -> None:
    with context.database.write() as session:
        export = _at_work(session, export_id)
        export.done = min(done, export.total)


def _fail(context: ServiceContext, export_id: int, error: dict[str, Any]) -> bool:
    """Note why an export failed; False if it is over or gone already."""
    try:
        with context.database.write() as session:
            export = _at_work(session, export_id)
            export.state, export.finished_at, export.error = "failed", utc_now(), error
    except JobStopped:
        return False
    return True
