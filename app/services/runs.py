"""Runs: one configuration applied to a whole dataset, in the background.

The work of a run is done outside of any transaction; then one transaction looks for
frames that came in meanwhile, stores what changed, and makes its verdicts current.
Nobody ever sees a dataset that is half decided.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from sqlalchemy import event
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.tables import Run
from app.engine import Job, JobStopped
from app.errors import AppError, Conflict
from app.repositories.evidence import EvidenceRepository
from app.repositories.frames import FrameRepository
from app.repositories.runs import ConfigRepository, RunRepository
from app.services.cancelling import interrupt_until_written
from app.services.configs import config_of
from app.services.context import ServiceContext
from app.services.run_measuring import is_measured, measure_missing
from app.services.run_states import OPEN, job_of, run_at_work
from app.services.run_switching import BeforeAndAfter, switch
from filter_core.config import FilterConfig
from filter_core.errors import FilterError

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunScope:
    """The identities of one run, read once."""

    run_id: int
    dataset_id: int
    measurement_id: int
    config: FilterConfig

    @property
    def job(self) -> Job:
        """The job that carries it out."""
        return job_of(self.run_id)


def start_runs(context: ServiceContext) -> None:
    """Queue every run that is not finished; those that a crash cut off start anew."""
    with context.database.read() as session:
        waiting = [run.id for run in RunRepository(session).unfinished()]
    for run_id in waiting:
        context.engine.submit(partial(carry_out, context, run_id))


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
    interrupt_until_written(context, session, job_of(run_id), start_runs)
    run = RunRepository(session).with_id(run_id)
    if run.state not in OPEN:
        raise Conflict(f"run {run_id} is {run.state} already", code="run_over")
    run.state, run.finished_at = "cancelled", utc_now()
    session.flush()
    return run


def carry_out(context: ServiceContext, run_id: int) -> None:
    """Do one run from its row to its end; safe to call again after a crash."""
    try:
        _finish(context, _begin(context, run_id))
    except JobStopped:
        return
    except (AppError, FilterError) as error:
        log.warning("run %d failed: %s", run_id, error)
        _fail(context, run_id, {"code": error.kind, "detail": error.detail})
    except Exception:
        if _fail(context, run_id, {"code": "internal", "detail": "the run failed"}):
            raise
        # Somebody cancelled it, or deleted its dataset, between two statements.
        log.info("run %d ended: nobody wants it any more", run_id)
    finally:
        context.engine.over(job_of(run_id))


def _begin(context: ServiceContext, run_id: int) -> RunScope:
    with context.database.write() as session:
        run = run_at_work(session, run_id)
        if run.state == "queued":
            run.total = FrameRepository(session).count(run.dataset_id)
        run.state, run.started_at = "running", run.started_at or utc_now()
        # What an earlier run has measured, or this one before a crash, is done already.
        missing = EvidenceRepository(session).count_unmeasured(
            run.dataset_id, run.measurement_id or 0
        )
        if missing:
            run.done = max(run.done, run.total - missing)
        config = config_of(ConfigRepository(session).with_id(run.config_id))
        session.flush()
        return RunScope(run.id, run.dataset_id, run.measurement_id or 0, config)


def _finish(context: ServiceContext, scope: RunScope) -> None:
    """Measure, decide and switch; repeated for frames that came in meanwhile."""
    while True:
        measure_missing(context, scope)
        # Loading a million numbers holds no lock; the transaction finds them cached.
        with context.database.read() as session:
            run = run_at_work(session, scope.run_id)
            BeforeAndAfter.load(context, session, run)
        with context.database.write() as session:
            run = run_at_work(session, scope.run_id)
            if is_measured(session, scope):
                switch(context, session, run, scope.config)
                return


def _fail(context: ServiceContext, run_id: int, error: Mapping[str, Any]) -> bool:
    """Note why a run failed; False if it is over or gone already."""
    try:
        with context.database.write() as session:
            run = run_at_work(session, run_id)
            run.state, run.finished_at, run.error = "failed", utc_now(), dict(error)
    except JobStopped:
        return False
    return True
