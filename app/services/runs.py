"""Runs: one configuration applied to a whole dataset, in the background.

The work of a run is done outside of any transaction; then one transaction looks for
frames that came in meanwhile, stores what changed, and makes its verdicts current.
Nobody ever sees a dataset that is half decided.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import partial
from typing import Any

from sqlalchemy import event
from sqlalchemy.orm import Session

from app.boxes.queries import FrameRepository
from app.context import ServiceContext
from app.db.base import utc_now
from app.db.tables import Run
from app.db.transient import in_a_line, is_transient
from app.engine import JobStopped
from app.errors import AppError, Conflict
from app.jobs.driver import ChunkDriver, ChunkFailed
from app.jobs.leases import JobLease
from app.jobs.queries import DECISION, ChunkRepository, Span
from app.measuring.queries import EvidenceRepository
from app.repositories.runs import RunRepository
from app.services.cancelling import interrupt_until_written
from app.services.run_measuring import RunScope, plan_frames
from app.services.run_states import OPEN, job_of, run_at_work
from filter_core.errors import FilterError

log = logging.getLogger(__name__)


def start_runs(context: ServiceContext, *, at_work: bool = False) -> None:
    """Queue every run that is not finished; those that a crash cut off go on.

    Those that are carried out here already only on request: one may just be letting go.
    """
    with context.database.read() as session:
        waiting = [run.id for run in RunRepository(session).unfinished()]
    here = frozenset() if at_work else context.leases.at_work
    for run_id in waiting:
        if job_of(run_id) not in here:
            context.engine.submit(partial(_drive, context, run_id), job_of(run_id))


def start_after(context: ServiceContext, session: Session) -> None:
    """Start what this transaction has queued, once it is committed."""
    event.listen(session, "after_commit", lambda _: start_runs(context), once=True)


def cancel_run(context: ServiceContext, session: Session, run_id: int) -> Run:
    """End a run that is not over; what it has measured stays for the next one.

    Raises
    ------
    Conflict
        The run is over.
    """
    again = partial(start_runs, at_work=True)
    interrupt_until_written(context, session, job_of(run_id), again)
    run = RunRepository(session).with_id(run_id)
    if run.state not in OPEN:
        raise Conflict(f"run {run_id} is {run.state} already", code="run_over")
    run.state, run.finished_at = "cancelled", utc_now()
    session.flush()
    ChunkRepository(session).forget(job_of(run_id))
    # One that had to wait for it has been looked at already.
    start_after(context, session)
    return run


def _drive(context: ServiceContext, run_id: int) -> None:
    if carry_out(context, run_id):
        # Those that had to wait for this one, here or in another process.
        start_runs(context)


def carry_out(context: ServiceContext, run_id: int) -> bool:
    """Drive one run from its row to its end; safe to call again after a crash.

    Nothing happens if another process drives it, or if an earlier run has to end
    first. True if it is over.
    """
    with context.leases.driving(context.database, job_of(run_id)) as lease:
        try:
            _finish(context, _begin(context, lease, run_id), lease)
        except JobStopped:
            return False
        except ChunkFailed as failed:
            log.warning("run %d failed: %s", run_id, failed)
            _fail(context, lease, failed.error)
        except (AppError, FilterError) as error:
            log.warning("run %d failed: %s", run_id, error)
            _fail(context, lease, {"code": error.kind, "detail": error.detail})
        except Exception as error:
            if is_transient(error):
                # Nothing is lost: `job_watch` starts it again.
                log.warning("run %d is cut off: %s", run_id, in_a_line(error))
                return False
            unexpected = {"code": "internal", "detail": "the run failed"}
            if _fail(context, lease, unexpected):
                raise
            # Somebody cancelled it, or deleted its dataset, between two statements.
            log.info("run %d ended: nobody wants it any more", run_id)
        finally:
            context.engine.over(job_of(run_id))
    return True


def _begin(context: ServiceContext, lease: JobLease, run_id: int) -> RunScope:
    with context.database.write() as session:
        run = run_at_work(session, run_id)
        if RunRepository(session).has_to_wait(run):
            raise JobStopped(lease.job)
        lease.take(session)
        ChunkRepository(session).begin_again(lease.job)
        if run.state == "queued":
            run.total = FrameRepository(session).count(run.dataset_id)
        run.state, run.started_at = "running", run.started_at or utc_now()
        # What an earlier run has measured, or this one before a crash, is done already.
        missing = EvidenceRepository(session).count_unmeasured(
            run.dataset_id, run.measurement_id or 0
        )
        if missing:
            run.done = max(run.done, run.total - missing)
        session.flush()
        return RunScope.of(session, run)


def _finish(context: ServiceContext, scope: RunScope, lease: JobLease) -> None:
    """Measure and decide; repeated for frames that came in meanwhile.

    Deciding is arithmetic, and is done here whatever the engine is.
    """
    is_over = False
    while not is_over:
        driver = _driver(context, scope, lease)
        driver.drive()
        with context.database.write() as session:
            lease.require(session)
            run = run_at_work(session, scope.run_id)
            ChunkRepository(session).plan_decision(scope.job, run.total)
        driver.drive_here(DECISION)
        with context.database.read() as session:
            found = RunRepository(session).find(scope.run_id)
            is_over = found is None or found.state not in OPEN


def _driver(context: ServiceContext, scope: RunScope, lease: JobLease) -> ChunkDriver:
    """Of the numbers that are not there yet, chunk by chunk."""
    with context.database.read() as session:
        run = run_at_work(session, scope.run_id)
    frames = context.engine.chunk_frames(run.total - run.done)

    def more(session: Session, after: int, most: int) -> list[Span]:
        return plan_frames(session, scope, after, spans=most, frames=frames)

    return ChunkDriver(context, lease, more, run_at_work)


def _fail(context: ServiceContext, lease: JobLease, error: Mapping[str, Any]) -> bool:
    """Note why a run failed; False if it is over, gone or another's already.

    Chunks in quarantine are kept for who wants to know.
    """
    try:
        with context.database.write() as session:
            run = run_at_work(session, lease.job.id)
            lease.take(session)  # in case that it could not even begin
            lease.end(session)
            run.state, run.finished_at, run.error = "failed", utc_now(), dict(error)
            ChunkRepository(session).forget(lease.job, quarantined=False)
    except JobStopped:
        return False
    return True
