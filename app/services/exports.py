"""Exports: asking for the labels of a dataset, and getting them.

`export_jobs` writes them in the background.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from sqlalchemy import event
from sqlalchemy.orm import Session

from app.boxes.queries import FrameRepository
from app.context import ServiceContext
from app.db import tables
from app.db.base import utc_now
from app.db.tables import Dataset
from app.errors import Conflict
from app.jobs.queries import ChunkRepository
from app.measuring.queries import DatasetRepository
from app.repositories.runs import ExportRepository
from app.services.cancelling import interrupt_until_written
from app.services.export_jobs import OPEN, job_of, start_exports
from app.services.job_quota import require_a_place
from app.storage import Blob
from app.storage.room import require_room
from filter_core.formats.export import ExportOptions
from filter_core.formats.registry import format_of
from unghost.wire.runs import Export

MEDIA_TYPE: Final = "application/zip"


@dataclass(frozen=True)
class ExportRequest:
    """An export as it was asked for."""

    format: str
    options: dict[str, Any]
    author: str


def request_export(
    context: ServiceContext, session: Session, dataset: Dataset, wanted: ExportRequest
) -> tables.Export:
    """Store a queued export and start it when the transaction is over.

    From now on the dataset's classes keep their order: labels refer to it.
    """
    format_of(wanted.format, ExportOptions.from_mapping(wanted.options))
    require_a_place(session, context.settings, wanted.author)
    require_room(context.settings, context.storage)
    exports = ExportRepository(session)
    DatasetRepository(session).freeze_classes(dataset.id)
    export = exports.add(
        tables.Export(
            dataset_id=dataset.id,
            format=wanted.format,
            options=wanted.options,
            run_id=dataset.active_run_id,
            total=FrameRepository(session).count(dataset.id),
            media_type=MEDIA_TYPE,
            created_by=wanted.author,
        )
    )
    event.listen(session, "after_commit", lambda _: start_exports(context), once=True)
    return export


def cancel_export(
    context: ServiceContext, session: Session, export_id: int
) -> tables.Export:
    """End an export that is not over; nothing is kept of it.

    Raises
    ------
    Conflict
        The export is over.
    """
    again = partial(start_exports, at_work=True)
    interrupt_until_written(context, session, job_of(export_id), again)
    export = ExportRepository(session).with_id(export_id)
    if export.state not in OPEN:
        raise Conflict(
            f"export {export_id} is {export.state} already", code="export_over"
        )
    export.state, export.finished_at = "cancelled", utc_now()
    session.flush()
    ChunkRepository(session).forget(job_of(export_id))
    return export


def finished_file(context: ServiceContext, export: tables.Export) -> Blob:
    """The file of a finished export; Conflict while it is not."""
    if export.state != "done" or export.sha256 is None:
        raise Conflict(
            f"export {export.id} is {export.state}; it can be downloaded when done",
            code="export_not_done",
        )
    return context.storage.whole(export.sha256, size_bytes=export.size_bytes)


def describe_export(export: tables.Export, dataset: str) -> Export:
    """An export as it is answered."""
    done = export.state == "done"
    return Export.model_validate(
        {
            "id": export.id,
            "dataset": dataset,
            "format": export.format,
            "options": export.options,
            "state": export.state,
            "total": export.total,
            "done": export.done,
            "size_bytes": export.size_bytes,
            "sha256": export.sha256,
            "counts": export.counts,
            "error": export.error,
            "created_at": export.created_at,
            "download": f"/api/v1/exports/{export.id}/download" if done else None,
        }
    )
