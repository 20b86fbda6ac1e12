"""Exports: requests for them, their jobs, their files and their descriptions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from sqlalchemy.orm import Session

from app.access.audit import AuditAction, AuditTrail
from app.boxes.queries import FrameRepository
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db import tables
from app.db.base import response_of
from app.db.tables import Chunk, Dataset
from app.errors import Conflict, TryLater
from app.exports.queries import VersionRepository
from app.exports.writer import write_archive
from app.jobs.chunks import ChunkRepository, PlannedChunk
from app.jobs.kind import Task
from app.jobs.queries import OPEN, job_of, job_with_id
from app.jobs.service import queue_job
from app.maintenance.datafolder import CannotMaintain
from app.maintenance.removals import remove_file_of_export
from app.runs.service import is_renaming_classes
from app.storage.base import StoredBlob
from app.storage.room import require_room
from filter_core.formats.export import ExportOptions
from filter_core.formats.registry import format_of
from filter_core.formats.splits import in_order_of_roles
from filter_core.formats.writing import Parts
from unghost.wire import runs as wire

MEDIA_TYPE: Final = "application/zip"
_RETRY_S: Final = 30


def request_export(
    context: ServiceContext,
    session: Session,
    dataset: Dataset,
    request: wire.ExportIn,
    author: str,
) -> tables.Export:
    """Queue an export; it starts when the transaction is committed.

    If the format's labels name classes by their numbers, the dataset's classes keep
    their names and their order from now on. Raises Conflict: ``classes_change``: an
    open run renames classes, whose numbers it changes. ``version_exists``: another
    export has the name; NotFound: there is no version `since`.
    """
    versions = VersionRepository(session, dataset)
    if request.since is not None:
        versions.named(request.since)
    taken = None if request.name is None else versions.export_of(request.name)
    if taken is not None:
        raise Conflict(
            f"dataset {dataset.name!r} has a version {request.name!r} already, export "
            f"{taken}; choose another name, or delete that export",
            code="version_exists",
        )
    options = request.options.model_dump()
    fmt = format_of(request.format, ExportOptions.from_mapping(options))
    require_room(context.settings, context.storage)
    if fmt.numbers_classes:
        if is_renaming_classes(session, dataset):
            raise Conflict(
                f"a run is renaming classes of dataset {dataset.name!r}, whose numbers "
                f"labels in the format {fmt.name!r} refer to; export when it has ended",
                code="classes_change",
            )
        DatasetRepository(session).freeze_classes(dataset.id)
    export = tables.Export(
        dataset_id=dataset.id,
        format=request.format,
        options=options,
        run_id=dataset.active_run_id,
        total=FrameRepository(session).count(dataset.id),
        media_type=MEDIA_TYPE,
        created_by=author,
        name=request.name,
        since=request.since,
    )
    queue_job(context, session, export)
    return export


def planned_parts(
    session: Session, dataset: Dataset, shares: Sequence[float]
) -> wire.Parts:
    """The parts that an export with these shares would make now.

    Raises ExportError if they are no shares.
    """
    parts = Parts(ExportOptions.from_mapping({"split": list(shares)}))
    for frame in FrameRepository(session).parts_told(dataset.id):
        parts.of(frame)
    return wire.Parts(
        frames={name: parts.frames[name] for name in in_order_of_roles(parts.frames)},
        sequences={name: len(some) for name, some in parts.sequences.items()},
        split=dict(parts.told),
    )


def delete_export(audit: AuditTrail, context: ServiceContext, export_id: int) -> None:
    """Delete an export that has ended, and its file if no other export has the same.

    Raises NotFound: there is no such export; Conflict: ``export_open``: it is queued or
    running; TryLater: a backup is being made, or a garbage collection.
    """
    session = audit.session
    export = job_with_id(session, tables.Export, export_id)
    if export.state in OPEN:
        raise Conflict(
            f"export {export_id} is {export.state}; cancel it first, then delete it",
            code="export_open",
        )
    try:
        remove_file_of_export(session, context.settings, context.storage, export)
    except CannotMaintain as exc:
        raise TryLater(
            f"export {export_id} cannot be deleted while a backup or a garbage "
            "collection is running; try again when it has ended",
            retry_after_s=_RETRY_S,
        ) from exc
    ChunkRepository(session).forget(job_of(export), keep_quarantined=False)
    session.delete(export)
    session.flush()
    dataset = DatasetRepository(session).with_id(export.dataset_id).name
    audit.note(
        AuditAction.EXPORT_DELETED, export_id, dataset=dataset, format=export.format
    )


def finished_file(context: ServiceContext, export: tables.Export) -> StoredBlob:
    """The file of a finished export.

    Raises Conflict: ``export_not_done``: it is not finished; ``export_removed``: its
    file was deleted.
    """
    if export.state == "done" and export.sha256 is None:
        why = (export.error or {}).get("detail", "its file was deleted")
        raise Conflict(f"export {export.id}: {why}", code="export_removed")
    if export.state != "done" or export.sha256 is None:
        raise Conflict(
            f"export {export.id} is {export.state}; it can be downloaded when done",
            code="export_not_done",
        )
    return context.storage.open(export.sha256, size_bytes=export.size_bytes)


def describe_export(export: tables.Export, dataset: str) -> wire.Export:
    """An export as responses show it."""
    has_file = export.state == "done" and export.sha256 is not None
    return response_of(
        wire.Export,
        export,
        dataset=dataset,
        # Validated on creation, perhaps by an earlier version: read leniently.
        options=wire.ExportOptions.read(export.options),
        download=f"/api/v1/exports/{export.id}/download" if has_file else None,
    )


class ExportJobs:
    """The job kind of exports: one chunk for all frames, which sees one snapshot."""

    table = tables.Export
    final_step_words: str | None = None
    work = staticmethod(write_archive)

    def may_begin(self, _session: Session, _row: tables.Export) -> bool:
        """True: an export never waits for another job."""
        return True

    def begin(self, session: Session, row: tables.Export) -> None:
        """Count the frames; an interrupted export starts again."""
        row.done, row.total = 0, FrameRepository(session).count(row.dataset_id)

    def plan(
        self,
        session: Session,
        row: tables.Export,
        *,
        after: int,
        most: int,
        frames: int,
    ) -> list[PlannedChunk]:
        """The only chunk; empty if it is planned already."""
        has_chunks = ChunkRepository(session).has_chunks(job_of(row))
        return [] if has_chunks else [PlannedChunk(0, 0, row.total)]

    def finish(self, task: Task[tables.Export]) -> None:
        """Do nothing: the only chunk of an export ends it."""

    def unfinished(
        self, _session: Session, _row: tables.Export, _chunk: Chunk
    ) -> list[int]:
        """Empty: it is not known which frame of an export has ended a process."""
        return []

    def name_unfinished(
        self, _session: Session, _row: tables.Export, _chunks: Sequence[Chunk]
    ) -> str:
        """A phrase for errors: an export has no parts to name."""
        return "writing it"

    def describe(
        self, _context: ServiceContext, session: Session, row: tables.Export
    ) -> wire.Export:
        """An export with the name of its dataset."""
        dataset = DatasetRepository(session).with_id(row.dataset_id)
        return describe_export(row, dataset.name)


EXPORTS: Final = ExportJobs()
