"""SQL of jobs: the columns that all kinds of jobs share.

A job is a row of its kind's table (`JobRow`). It is *open* while it is queued or
running. Then `close`, and nothing else, ends it: it is done, failed or cancelled.

Rows of chunks are in `app.jobs.chunks`, rows of leases in `app.jobs.leases`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, TypeVar

from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session

from app.catalog.datasets import is_deleted
from app.db.base import existing, utc_now
from app.db.tables import Chunk, Installation, JobRow, Lease
from app.engine.chunk import Job, JobStopped
from app.jobs.chunks import ChunkRepository
from unghost.wire.words import FinishedState

OPEN: Final = ("queued", "running")
"""The states of a job that has not ended."""

Row = TypeVar("Row", bound=JobRow)


def job_of(row: JobRow) -> Job:
    """The identity of a row's job in engines, chunks and leases."""
    return Job(row.job_kind, row.id)


def find_job(session: Session, table: type[Row], job_id: int) -> Row | None:
    """A job's row, unless it was deleted with its dataset."""
    row = session.get(table, job_id)
    return None if row is None or is_deleted(session, row.dataset_id) else row


def job_with_id(session: Session, table: type[Row], job_id: int) -> Row:
    """A job's row; NotFound, also if it was deleted with its dataset."""
    row = find_job(session, table, job_id)
    return existing(row, table.job_kind, job_id)


def require_open_job(session: Session, table: type[Row], job_id: int) -> Row:
    """The row of a job that is queued or running.

    Raises JobStopped if the job has ended, or its dataset was deleted.
    """
    row = find_job(session, table, job_id)
    if row is None or row.state not in OPEN:
        raise JobStopped(Job(table.job_kind, job_id))
    return row


def open_jobs(
    session: Session, table: type[JobRow], dataset_id: int | None = None
) -> list[Job]:
    """Jobs that are queued or running, oldest first: all, or those of a dataset."""
    rows = select(table.id).where(table.state.in_(OPEN)).order_by(table.id)
    if dataset_id is not None:
        rows = rows.where(table.dataset_id == dataset_id)
    return [Job(table.job_kind, id_) for id_ in session.scalars(rows)]


def count_open(session: Session, table: type[JobRow]) -> int:
    """How many jobs of a kind are queued or running."""
    rows = select(func.count(table.id)).where(table.state.in_(OPEN))
    return session.scalar(rows) or 0


def tell_done(session: Session, row: type[JobRow], job_id: int, done: int) -> None:
    """Store the progress of a running job, unless a higher one is stored."""
    further = row.id == job_id, row.state == "running", row.done < done
    session.execute(update(row).where(*further).values(done=done))


_AT_END: Final[list[Callable[[Session, JobRow], None]]] = []


def call_at_end(call: Callable[[Session, JobRow], None]) -> None:
    """Call a function in each transaction of this process that ends a job."""
    if call not in _AT_END:
        _AT_END.append(call)


def close(
    session: Session,
    row: JobRow,
    state: FinishedState,
    error: Mapping[str, object] | None = None,
) -> None:
    """End a job; raises JobStopped if it has ended already.

    Its chunks are removed, except the quarantined ones of a failed job, which show why
    it failed.
    """
    if row.state not in OPEN:
        raise JobStopped(job_of(row))
    row.state, row.finished_at = state, utc_now()
    if error is not None:
        row.error = dict(error)
    session.flush()
    ChunkRepository(session).forget(job_of(row), keep_quarantined=state == "failed")
    for call in _AT_END:
        call(session, row)


def forget_jobs(session: Session, table: type[JobRow], dataset_id: int) -> None:
    """Delete the chunks and leases of a dataset's jobs of one kind."""
    jobs = select(table.id).where(table.dataset_id == dataset_id)
    for rows in (Chunk, Lease):
        of_jobs = rows.kind == table.job_kind, rows.job_id.in_(jobs)
        session.execute(delete(rows).where(*of_jobs))


def installation_id(session: Session) -> str:
    """The unique id of this database."""
    return session.scalar(select(Installation.id).limit(1)) or ""
