"""Writing an export: one consistent view of the database, streamed into one file.

The file is named by its content, and the same state gives the same bytes. An export
that was cut off is written anew: what is there of it belongs to a state that is gone.
It may be written by a worker, and by two of them: the first one that is done ends it.
"""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from sqlalchemy.orm import Session

from app.boxes.current import TallyRepository
from app.boxes.queries import FrameRepository, LatestAnswers
from app.context import ServiceContext
from app.db.tables import Dataset, Export
from app.jobs.kind import Task
from app.measuring.active import active_version
from app.measuring.queries import DatasetRepository
from app.services.export_archive import ReproducibleZip
from app.services.export_frames import ExportFrames
from filter_core.formats.export import ExportFrame, ExportHead, ExportOptions
from filter_core.formats.registry import format_of, write_export


def write_chunk(task: Task[Export]) -> None:
    """Write an export: it is the only chunk of its job, and ends it."""
    context = task.context
    task.check()
    with _empty_folder(context, task.job.id) as folder:
        file = folder / "export.zip"
        with context.database.read() as session:
            export = task.row(session)
            counts = _stream(task, session, export, file)
        size_bytes = file.stat().st_size
        put = partial(context.storage.adopt, file)
        digest = task.retry_unavailable(put)
    with context.database.write() as session:
        export = task.row(session)
        context.storage.require([digest])
        export.sha256, export.size_bytes = digest, size_bytes
        export.counts, export.done = counts, export.total
        task.end(session)
    # Whoever writes the same one beside us is told that it is over.
    _clear(context, task.job.id)


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
    task: Task[Export], session: Session, export: Export, file: Path
) -> dict[str, Any]:
    dataset = DatasetRepository(session).with_id(export.dataset_id)
    options = ExportOptions.from_mapping(export.options)
    needs = format_of(export.format, options).needs
    read = partial(_read, task)
    frames = ExportFrames(read, session, dataset, needs)
    head = replace(_head(session, dataset), temporary=file.parent)
    with ReproducibleZip(file) as archive:
        coming = _reporting(task, export.total, frames)
        return write_export(export.format, coming, archive.add, head, options)


def _read(task: Task[Export], digest: str) -> bytes:
    return task.retry_unavailable(partial(task.context.storage.read, digest))


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


def _reporting(
    task: Task[Export], total: int, frames: ExportFrames
) -> Iterator[ExportFrame]:
    """The frames, saying now and then how many have passed; the job can end here."""
    for done, frame in enumerate(frames):
        task.check()
        task.report(min(done, total))
        yield frame
