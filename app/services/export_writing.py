"""Writing an export: one consistent view of the database, streamed into one file.

The file is named by its content, and the same state gives the same bytes. An export
that was cut off is written anew: what is there of it belongs to a state that is gone.
It may be written by a worker, and by two of them: the first one that is done ends it.
"""

from __future__ import annotations

import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from sqlalchemy.orm import Session

from app.boxes.current import TallyRepository
from app.boxes.queries import FrameRepository, LatestAnswers
from app.context import ServiceContext
from app.db.base import utc_now
from app.db.tables import Dataset, Export
from app.engine import Job, JobStopped
from app.jobs.queries import ChunkRepository
from app.measuring.active import active_version
from app.measuring.queries import DatasetRepository
from app.repositories.runs import ExportRepository
from app.services.enduring import enduring
from app.services.export_archive import ReproducibleZip
from app.services.export_frames import ExportFrames
from filter_core.formats.export import ExportFrame, ExportHead, ExportOptions
from filter_core.formats.registry import format_of, write_export

OPEN: Final = ("queued", "running")
TELL_EVERY_S: Final = 0.5


def job_of(export_id: int) -> Job:
    """The job that writes an export."""
    return Job("export", export_id)


def export_at_work(session: Session, export_id: int) -> Export:
    """The export, if it is to go on; JobStopped."""
    export = ExportRepository(session).find(export_id)
    if export is None or export.state not in OPEN:
        raise JobStopped(job_of(export_id))
    return export


def write_chunk(
    context: ServiceContext, export_id: int, _number: int, _stored: object
) -> None:
    """Write an export: it is the only chunk of its job, and ends it."""
    context.engine.check(job_of(export_id))
    with _empty_folder(context, export_id) as folder:
        file = folder / "export.zip"
        with context.database.read() as session:
            export = export_at_work(session, export_id)
            counts = _stream(context, session, export, file)
        size_bytes = file.stat().st_size
        put = partial(context.storage.adopt, file)
        digest = enduring(context, partial(_check, context, export_id), put)
    with context.database.write() as session:
        export = export_at_work(session, export_id)
        context.storage.require([digest])
        export.state, export.finished_at = "done", utc_now()
        export.sha256, export.size_bytes = digest, size_bytes
        export.counts, export.done = counts, export.total
        ChunkRepository(session).forget(job_of(export_id))
    # Whoever writes the same one beside us is told that it is over.
    _clear(context, export_id)


@contextmanager
def _empty_folder(context: ServiceContext, export_id: int) -> Iterator[Path]:
    """A place for one export, unlike that of an attempt that may still go on."""
    name = f"export-{export_id}-{secrets.token_hex(4)}"
    folder = context.storage.temporary_folder() / name
    folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _clear(context: ServiceContext, export_id: int) -> None:
    """Remove what attempts that were cut off have left."""
    temporary = context.storage.temporary_folder()
    for left in (f"export-{export_id}", f"export-{export_id}-*"):
        for folder in temporary.glob(left):
            shutil.rmtree(folder, ignore_errors=True)


def _stream(
    context: ServiceContext, session: Session, export: Export, file: Path
) -> dict[str, Any]:
    dataset = DatasetRepository(session).with_id(export.dataset_id)
    options = ExportOptions.from_mapping(export.options)
    needs = format_of(export.format, options).needs
    read = partial(_read, context, export.id)
    frames = ExportFrames(read, session, dataset, needs)
    head = replace(_head(session, dataset), temporary=file.parent)
    with ReproducibleZip(file) as archive:
        coming = _told(context, export.id, frames)
        return write_export(export.format, coming, archive.add, head, options)


def _read(context: ServiceContext, export_id: int, digest: str) -> bytes:
    read = partial(context.storage.read, digest)
    return enduring(context, partial(_check, context, export_id), read)


def _check(context: ServiceContext, export_id: int) -> None:
    context.engine.check(job_of(export_id))
    with context.database.read() as session:
        export_at_work(session, export_id)


def _head(session: Session, dataset: Dataset) -> ExportHead:
    tallies = TallyRepository(session).of_dataset(dataset.id)
    return ExportHead(
        classes=tuple(DatasetRepository(session).classes(dataset.id)),
        facts={
            "dataset": dataset.name,
            "run": dataset.active_run_id,
            "config": active_version(session, dataset).digest,
            "last_review": LatestAnswers(session).last_id(dataset.id),
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
        export = export_at_work(session, export_id)
        export.done = min(done, export.total)
