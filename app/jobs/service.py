"""Background jobs: queueing, starting and cancelling them, and the watchdog.

A job is **queued** by `ask` in the transaction of its caller, **running** once a
driver has taken it, and finally **done**, **failed** or **cancelled**.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Final

from sqlalchemy import event
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.engine import once_committed
from app.db.tables import JobRow
from app.engine import Job
from app.errors import Conflict, NotFound, TooManyRequests
from app.jobs.driver import drive_job
from app.jobs.kind import JobKind, kind_of, kinds
from app.jobs.leases import Leases, has_ended
from app.jobs.queries import (
    OPEN,
    ChunkRepository,
    LeaseRepository,
    Row,
    close,
    count_open,
    find_job,
    job_of,
    open_jobs,
)
from app.settings import Settings

WATCHDOG_EVERY_S: Final = 2.0
"""How often the watchdog looks for jobs that this process should drive."""
UNDRIVEN_FOR_S: Final = 10.0
"""Seconds that an open job may be without a driver before any service drives it.

The service that queued the job has this time to begin it.
"""
_RETRY_S: Final = 10

log = logging.getLogger(__name__)


def ask(context: ServiceContext, session: Session, row: JobRow) -> None:
    """Queue a job; it starts once the transaction is committed.

    Raises
    ------
    TooManyRequests
        The limit of open jobs of all tokens or of this token is reached.
    """
    require_place(session, context.settings, row.created_by)
    session.add(row)
    session.flush()
    once_committed(session, partial(start, context, [job_of(row)]))


def require_place(session: Session, settings: Settings, author: str) -> None:
    """Raise `TooManyRequests` unless one more job may be queued.

    Only one transaction writes at a time, so the count is still valid when the job is
    added.
    """
    tables = [kind.table for kind in kinds()]
    named = " and ".join(f"{table.job_kind}s" for table in tables)
    if sum(count_open(session, table) for table in tables) >= settings.max_open_runs:
        raise TooManyRequests(
            f"{settings.max_open_runs} {named} are queued or running already; "
            "try again when one of them has ended",
            retry_after_s=_RETRY_S,
        )
    own = sum(count_open(session, table, author) for table in tables)
    if own >= settings.max_open_jobs_per_token:
        raise TooManyRequests(
            f"{own} {named} of {author!r} are queued or running already; cancel one, "
            "or try again when one has ended",
            retry_after_s=_RETRY_S,
            code="too_many_jobs",
        )


def start(
    context: ServiceContext, jobs: Iterable[Job], *, even_if_driven: bool = False
) -> None:
    """Let this process drive jobs, after those that are queued here already.

    A job that this process drives already is skipped; with `even_if_driven` it is
    driven once more afterwards. Jobs that have ended, or that another process drives,
    may be passed: `drive_job` checks for them.
    """
    here = frozenset() if even_if_driven else context.one(Leases).driven
    for job in jobs:
        if job not in here and not context.engine.stopping.is_set():
            context.engine.submit(partial(_drive, context, job), job)


def _drive(context: ServiceContext, job: Job) -> None:
    if drive_job(context, job):
        start_waiting(context, job)


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
    context: ServiceContext, session: Session, kind: JobKind[Row], job_id: int
) -> Row:
    """Cancel a job; results that it has stored so far stay.

    If the transaction fails, the job continues.

    Raises
    ------
    NotFound
        There is no such job.
    Conflict
        It has ended already.
    """
    job = Job(kind.table.job_kind, job_id)
    interrupt(context, session, job)
    row = find_job(session, kind.table, job_id)
    if row is None:
        raise NotFound(*job)
    if row.state not in OPEN:
        detail = f"{job.kind} {job_id} is {row.state} already"
        raise Conflict(detail, code=f"{job.kind}_over")
    close(session, row, "cancelled")
    once_committed(session, partial(start_waiting, context, job))
    return row


def interrupt(context: ServiceContext, session: Session, job: Job) -> None:
    """Tell a job that it is being cancelled; called before the first statement.

    The session's first statement waits for its turn to write, which the final step of
    this job may hold. On PostgreSQL the final step is withdrawn in a separate
    transaction, so that a job in another process notices as well. On SQLite, where
    nothing can be written meanwhile, a flag in this process signals it.
    """
    context.engine.interrupt(job)
    if not context.database.has_one_writer:
        # Not in the caller's session: its first statement waits for its turn to write.
        with context.database.write_beside() as beside:
            ChunkRepository(beside).withdraw_final(job)
    clear = partial(context.engine.clear_cancel, job)
    event.listen(session, "after_transaction_end", lambda *_: clear())
    again = partial(start, context, [job], even_if_driven=True)
    event.listen(session, "after_rollback", lambda _: again())


def all_open_jobs(session: Session, dataset_id: int) -> list[Job]:
    """The jobs of a dataset, of every kind, that are queued or running."""
    return [
        found
        for kind in kinds()
        for found in open_jobs(session, kind.table, dataset_id)
    ]


def end_all(session: Session, dataset_id: int) -> None:
    """Cancel the open jobs of a dataset that is being deleted; delete all chunks."""
    chunks = ChunkRepository(session)
    for kind in kinds():
        for job in open_jobs(session, kind.table, dataset_id):
            row = find_job(session, kind.table, job.id)
            if row is not None:
                close(session, row, "cancelled")
        chunks.forget_dataset(kind.table, dataset_id)


@contextmanager
def running_watchdog(context: ServiceContext) -> Iterator[None]:
    """Start unfinished jobs now, and check for more at intervals during the block."""
    with context.database.read() as session:
        unfinished = _unfinished(session)
    start(context, unfinished)
    ends = threading.Event()
    watchdog = threading.Thread(
        target=_run_watchdog, args=(context, ends), name="watchdog"
    )
    watchdog.start()
    try:
        yield
    finally:
        ends.set()
        watchdog.join()


def _unfinished(session: Session) -> list[Job]:
    """All unfinished jobs, kind by kind, oldest first."""
    return [job for kind in kinds() for job in open_jobs(session, kind.table)]


def _run_watchdog(context: ServiceContext, ends: threading.Event) -> None:
    watchdog = Watchdog(context)
    while not ends.wait(WATCHDOG_EVERY_S) and not context.engine.stopping.is_set():
        try:
            start(context, watchdog.abandoned())
        except SQLAlchemyError as exc:  # the database may be unavailable for a while
            log.warning("cannot look for unfinished jobs: %s", exc)


class Watchdog:
    """Records since when each unfinished job has been without a driver.

    It uses its own clock, because the clock of the service that queued a job may be
    wrong.
    """

    def __init__(
        self, context: ServiceContext, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._context, self._clock = context, clock
        self._undriven_since: dict[Job, float] = {}

    def abandoned(self) -> list[Job]:
        """The unfinished jobs that this process should drive now.

        Those are jobs whose lease is void, since their driver has died, and jobs that
        have been without a lease for `UNDRIVEN_FOR_S` seconds. Void leases of jobs that
        are over are deleted.
        """
        with self._context.database.read() as session:
            unfinished = _unfinished(session)
            leased = LeaseRepository(session).leased_jobs(has_ended)
        if of_jobs_that_are_over := leased.void.difference(unfinished):
            self._clear(of_jobs_that_are_over)
        now, before = self._clock(), self._undriven_since
        undriven = [job for job in unfinished if job not in leased.driven]
        self._undriven_since = {job: before.get(job, now) for job in undriven}
        return [
            job
            for job in undriven
            if job in leased.void or now - self._undriven_since[job] >= UNDRIVEN_FOR_S
        ]

    def _clear(self, jobs: Iterable[Job]) -> None:
        with self._context.database.write_beside() as session:
            for job in jobs:
                LeaseRepository(session).clear(job, has_ended)
