"""Exports: the labels of one state of a dataset, written once and kept.

An export is made in the background from one consistent view of the database, streamed
into a file, and named by its content. The same state gives the same bytes.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from sqlalchemy import event
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.tables import Dataset, Export
from app.errors import Conflict, TooManyRequests
from app.repositories.datasets import DatasetRepository
from app.repositories.frames import FrameRepository
from app.repositories.reviews import ReviewRepository
from app.repositories.runs import ExportRepository
from app.repositories.tallies import TallyRepository
from app.services.configs import active_version
from app.services.context import ServiceContext
from app.services.export_archive import ReproducibleZip
from app.services.export_frames import ExportFrames
from app.services.timestamps import rfc3339
from filter_core.errors import FilterError
from filter_core.formats.decisions_writer import write_decisions
from filter_core.formats.export_frame import ExportHead
from filter_core.formats.yolo_writer import YoloOptions, write_yolo

MEDIA_TYPE: Final = "application/zip"


@dataclass(frozen=True)
class ExportRequest:
    """An export as it was asked for."""

    format: str
    options: dict[str, Any]
    author: str


def request_export(
    context: ServiceContext, session: Session, dataset: Dataset, wanted: ExportRequest
) -> Export:
    """Store a queued export and start it when the transaction is over.

    From now on the dataset's classes keep their order: labels refer to it.
    """
    exports = ExportRepository(session)
    limit = context.settings.max_open_runs
    if exports.open_count() >= limit:
        raise TooManyRequests(f"{limit} exports wait or work already; try later")
    DatasetRepository(session).freeze_classes(dataset.id)
    export = exports.add(
        Export(
            dataset_id=dataset.id,
            format=wanted.format,
            options=wanted.options,
            run_id=dataset.active_run_id,
            created_by=wanted.author,
        )
    )
    event.listen(session, "after_commit", lambda _: start_exports(context), once=True)
    return export


def start_exports(context: ServiceContext) -> None:
    """Queue every export that is not finished; one that was cut off starts anew."""
    with context.database.read() as session:
        waiting = [export.id for export in ExportRepository(session).unfinished()]
    for export_id in waiting:
        context.engine.submit(partial(make_export, context, export_id))


def make_export(context: ServiceContext, export_id: int) -> None:
    """Write one export from its row to its end; safe to call again after a crash."""
    with context.database.write() as session:
        export = ExportRepository(session).with_id(export_id)
        if export.state not in ("queued", "running"):
            return
        export.state = "running"
    try:
        _write(context, export_id)
    except ExportStopped:
        return
    except FilterError as error:
        _fail(context, export_id, {"code": error.kind, "detail": error.detail})
    except Exception:
        _fail(context, export_id, {"code": "internal", "detail": "the export failed"})
        raise


def finished_file(context: ServiceContext, export: Export) -> Path:
    """The file of a finished export; Conflict while it is not."""
    if export.state != "done" or export.sha256 is None:
        raise Conflict(
            f"export {export.id} is {export.state}; it can be downloaded when done",
            code="export_not_done",
        )
    return context.storage.path(export.sha256)


def describe_export(export: Export, dataset: str) -> dict[str, Any]:
    """An export as it is answered."""
    done = export.state == "done"
    return {
        "id": export.id,
        "dataset": dataset,
        "format": export.format,
        "options": export.options,
        "state": export.state,
        "size_bytes": export.size_bytes,
        "sha256": export.sha256,
        "counts": export.counts,
        "error": export.error,
        "created_at": rfc3339(export.created_at),
        "download": f"/api/v1/exports/{export.id}/download" if done else None,
    }


def _write(context: ServiceContext, export_id: int) -> None:
    folder = context.storage.temporary_folder()
    with tempfile.TemporaryDirectory(dir=folder, prefix="export-") as name:
        file = Path(name) / "export.zip"
        with context.database.read() as session:
            export = ExportRepository(session).with_id(export_id)
            counts = _stream(context, session, export, file)
        size_bytes = file.stat().st_size
        digest = context.storage.adopt(file)
    with context.database.write() as session:
        export = ExportRepository(session).with_id(export_id)
        export.state, export.finished_at = "done", utc_now()
        export.sha256, export.size_bytes = digest, size_bytes
        export.media_type, export.counts = MEDIA_TYPE, counts


def _stream(
    context: ServiceContext, session: Session, export: Export, file: Path
) -> dict[str, Any]:
    dataset = DatasetRepository(session).with_id(export.dataset_id)
    frames = ExportFrames(context, session, dataset)
    head = _head(session, dataset)
    with ReproducibleZip(file) as archive:
        if export.format == "yolo":
            options = YoloOptions(**export.options)
            write_yolo(_until_stopped(context, frames), archive.add, head, options)
        else:
            write_decisions(_until_stopped(context, frames), archive.add, head)
        counts: dict[str, Any] = archive.read_json("manifest.json")["counts"]
    return counts


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


class ExportStopped(Exception):
    """The service is stopping; the export starts anew when it starts again."""


def _until_stopped(context: ServiceContext, frames: ExportFrames) -> Iterator[Any]:
    for frame in frames:
        if context.engine.stopping.is_set():
            raise ExportStopped
        yield frame


def _fail(context: ServiceContext, export_id: int, error: dict[str, Any]) -> None:
    with context.database.write() as session:
        export = ExportRepository(session).with_id(export_id)
        export.state, export.finished_at, export.error = "failed", utc_now(), error
