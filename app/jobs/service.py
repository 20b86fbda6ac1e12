"""Background jobs: queueing, starting and cancelling them.

A job is **queued** by `queue_job` in the transaction of its caller, and **running**
once a driver has taken it. It ends as **done**, **failed** or **cancelled**.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Final

from sqlalchemy import event
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.engine import once_committed
from app.db.tables import JobRow
from app.engine.chunk import Job
from app.engine.local import CHUNK_FRAMES
from app.errors import Conflict, TooManyRequests
from app.jobs import queries
from app.jobs.chunks import ChunkRepository
from app.jobs.driver import drive_job
from app.jobs.kind import JobKind, all_open_jobs, kind_of, kinds
from app.jobs.leases import Leases
from app.settings import Settings

_RETRY_S: Final = 10


def queue_job(context: ServiceContext, session: Session, row: JobRow) -> None:
    """Queue a job; it starts once the transaction is committed.

    Raises TooManyRequests if as many jobs are open as the settings allow.
    """
    require_place(session, context.settings)
    session.add(row)
    session.flush()
    once_committed(session, partial(start, context, [queries.job_of(row)]))


def require_place(session: Session, settings: Settings) -> None:
    """Raise `TooManyRequests` unless one more job may be queued.

    Only one transaction writes at a time, so the count is still valid when the job is
    added.
    """
    tables = [kind.table for kind in kinds()]
    named = " and ".join(f"{table.job_kind}s" for table in tables)
    if (
        sum(queries.count_open(session, table) for table in tables)
        >= settings.max_open_runs
    ):
        raise TooManyRequests(
            f"{settings.max_open_runs} {named} are queued or running already; "
            "try again when one of them has ended",
            retry_after_s=_RETRY_S,
            code="too_many_jobs",
        )


def start(
    context: ServiceContext, jobs: Iterable[Job], *, even_if_driven: bool = False
) -> None:
    """Let this process drive jobs, after those that are queued here already.

    Jobs of more than `CHUNK_FRAMES` frames are long: they wait for each other only.
    A job that this process drives already is skipped; with `even_if_driven` it is
    driven once more afterwards. Jobs that have ended, or that another process drives,
    may be passed: `drive_job` checks for them.
    """
    here = frozenset() if even_if_driven else context.one(Leases).driven
    for job in jobs:
        if job not in here and not context.engine.stopping.is_set():
            context.engine.submit(partial(_drive, context, job), job)


def _drive(context: ServiceContext, job: Job) -> None:
    def drive() -> None:
        if drive_job(context, job):
            start_waiting(context, job)

    with context.database.read() as session:
        row = session.get(kind_of(job).table, job.id)
    if row is not None and row.total > CHUNK_FRAMES:
        context.engine.submit(drive, job, is_long=True)
    else:
        drive()


def start_waiting(context: ServiceContext, job: Job) -> None:
    """Start the open jobs of the dataset of a job that has ended.

    One of them may have been waiting for that end, and was skipped, by this or another
    process, when it was queued.
    """
    with context.database.read() as session:
        row = session.get(kind_of(job).table, job.id)
        if row is None:
            return
        waiting = all_open_jobs(session, row.dataset_id)
    start(context, waiting)


def cancel(
    context: ServiceContext, session: Session, kind: JobKind[queries.Row], job_id: int
) -> queries.Row:
    """Cancel a job; results that it has stored so far stay.

    If the transaction fails, the job continues. Raises NotFound: there is no such job;
    Conflict: it has ended already.
    """
    job = Job(kind.table.job_kind, job_id)
    interrupt(context, session, job)
    row = queries.job_with_id(session, kind.table, job_id)
    if row.state not in queries.OPEN:
        detail = f"{job.kind} {job_id} is {row.state} already"
        raise Conflict(detail, code=f"{job.kind}_over")
    queries.close(session, row, "cancelled")
    once_committed(session, partial(start_waiting, context, job))
    return row


def interrupt(context: ServiceContext, session: Session, job: Job) -> None:
    """Stop a job's work, so that its cancellation can be written.

    Called before the session's first statement, which waits for its turn to write: the
    final step of this job may hold it. A flag stops the work in this process. On
    PostgreSQL the final step is also withdrawn, in a transaction of its own, so that
    another process stops as well. If the session is rolled back, the job starts again.
    """
    context.engine.interrupt(job)
    if not context.database.has_one_writer:
        # Not in the caller's session: its first statement waits for its turn to write.
        with context.database.write_out_of_turn() as beside:
            ChunkRepository(beside).withdraw_final_step(job)
    clear = partial(context.engine.clear_cancel, job)
    event.listen(session, "after_transaction_end", lambda *_: clear())
    again = partial(start, context, [job], even_if_driven=True)
    event.listen(session, "after_rollback", lambda _: again())


def end_all(session: Session, dataset_id: int) -> None:
    """Cancel the open jobs of a dataset that is being deleted.

    The chunks and leases of all its jobs are deleted.
    """
    for kind in kinds():
        for job in queries.open_jobs(session, kind.table, dataset_id):
            row = queries.find_job(session, kind.table, job.id)
            if row is not None:
                queries.close(session, row, "cancelled")
        queries.forget_jobs(session, kind.table, dataset_id)
