"""Exports in the background: each is one chunk, written here or by a worker."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import partial
from typing import Any

from sqlalchemy.orm import Session

from app.boxes.queries import FrameRepository
from app.context import ServiceContext
from app.db.base import utc_now
from app.db.transient import in_a_line, is_transient
from app.engine import JobStopped
from app.jobs.driver import ChunkDriver, ChunkFailed
from app.jobs.leases import JobLease
from app.jobs.queries import ChunkRepository, Span
from app.repositories.runs import ExportRepository
from app.services.export_writing import OPEN, export_at_work, job_of

__all__ = ["OPEN", "job_of", "make_export", "start_exports"]

log = logging.getLogger(__name__)


def start_exports(context: ServiceContext, *, at_work: bool = False) -> None:
    """Queue every export that is not finished; one that was cut off starts anew.

    Those that are made here already only on request: one may just be letting go.
    """
    with context.database.read() as session:
        waiting = [export.id for export in ExportRepository(session).unfinished()]
    here = frozenset() if at_work else context.leases.at_work
    for export_id in waiting:
        if job_of(export_id) not in here:
            work = partial(make_export, context, export_id)
            context.engine.submit(work, job_of(export_id))


def make_export(context: ServiceContext, export_id: int) -> None:
    """Drive one export from its row to its end; safe to call again after a crash."""
    with context.leases.driving(context.database, job_of(export_id)) as lease:
        try:
            _begin(context, lease, export_id)
            ChunkDriver(context, lease, _whole, export_at_work).drive()
        except JobStopped:
            return
        except ChunkFailed as failed:
            log.warning("export %d failed: %s", export_id, failed)
            _fail(context, lease, failed.error)
        except Exception as error:
            if is_transient(error):
                # Nothing is lost: `job_watch` starts it again.
                log.warning("export %d is cut off: %s", export_id, in_a_line(error))
                return
            unexpected = {"code": "internal", "detail": "the export failed"}
            if _fail(context, lease, unexpected):
                raise
            # Somebody cancelled it, or deleted its dataset, between two statements.
            log.info("export %d ended: nobody wants it any more", export_id)


def _begin(context: ServiceContext, lease: JobLease, export_id: int) -> None:
    with context.database.write() as session:
        export = export_at_work(session, export_id)
        lease.take(session)
        export.state, export.done = "running", 0
        export.total = FrameRepository(session).count(export.dataset_id)
        ledger = ChunkRepository(session)
        ledger.begin_again(lease.job)
        if not ledger.is_planned(lease.job):
            ledger.plan(lease.job, [Span(0, 0, export.total)])


def _whole(_session: Session, _after: int, _most: int) -> list[Span]:
    """Nothing more: an export is one chunk, so that it sees one state."""
    return []


def _fail(context: ServiceContext, lease: JobLease, error: Mapping[str, Any]) -> bool:
    """Note why an export failed; False if it is over, gone or another's already."""
    try:
        with context.database.write() as session:
            export = export_at_work(session, lease.job.id)
            lease.take(session)  # in case that it could not even begin
            lease.end(session)
            export.state, export.finished_at = "failed", utc_now()
            export.error = dict(error)
            ChunkRepository(session).forget(lease.job, quarantined=False)
    except JobStopped:
        return False
    return True
