"""Working on one chunk of a job, in the driver's process or in a worker's.

What goes wrong is written into the chunk's row: errors never travel with an answer.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any, Final

from sqlalchemy.orm import Session

from app.db.transient import in_a_line, is_transient
from app.engine import Job, JobStopped
from app.engine.chunk import DONE, ELSEWHERE, FAILED, GIVEN_BACK, GIVEN_UP, UNWANTED
from app.errors import AppError
from app.repositories.leases import LeaseRepository
from app.repositories.ledger import DECISION, LedgerRepository
from app.services.chunk_attempts import Attempt
from app.services.context import ServiceContext
from app.services.export_writing import export_at_work, write_chunk
from app.services.run_measuring import Stored, measure_chunk
from app.services.run_states import run_at_work
from app.services.run_switching import decide_all
from filter_core.errors import FilterError


def _measure_or_decide(
    context: ServiceContext, run_id: int, number: int, stored: Stored
) -> None:
    if number == DECISION:
        decide_all(context, run_id, stored)
    else:
        measure_chunk(context, run_id, number, stored)


Work = Callable[[ServiceContext, int, int, Stored], None]
_WORK: Final[Mapping[str, Work]] = {"run": _measure_or_decide, "export": write_chunk}
_AT_WORK: Final[Mapping[str, Callable[..., object]]] = {
    "run": run_at_work,
    "export": export_at_work,
}

log = logging.getLogger(__name__)


def work_on(context: ServiceContext, kind: str, job_id: int, number: int) -> str:
    """Work on a chunk, whatever comes; how it ended."""

    def work() -> str:
        _WORK[kind](context, job_id, number, _untold)
        return DONE

    return _outcome(context, Job(kind, job_id), number, work)


def work_here(context: ServiceContext, kind: str, job_id: int, number: int) -> str:
    """As `work_on`, in the process that drives the job: nobody is left if it ends.

    So the attempt is in the chunk's row before the work begins; once there were too
    many, it is given up.
    """
    attempt = Attempt(context, Job(kind, job_id), number)

    def work() -> str:
        if not attempt.begin():
            return GIVEN_UP
        _WORK[kind](context, job_id, number, attempt.forget)
        return DONE

    outcome = _outcome(context, Job(kind, job_id), number, work)
    if outcome not in (DONE, GIVEN_UP):
        attempt.end()
    return outcome


def _untold(_session: Session) -> None:
    """Who drives a worker is told when that ends, and counts."""


def _outcome(
    context: ServiceContext, job: Job, number: int, work: Callable[[], str]
) -> str:
    try:
        return work()
    except JobStopped:
        return GIVEN_BACK if context.engine.stopping.is_set() else UNWANTED
    except (AppError, FilterError) as error:
        return _failed(context, job, number, _told(error))
    except Exception as error:
        if is_transient(error):
            log.warning("chunk %d of %s %d: %s", number, *job, in_a_line(error))
            return GIVEN_BACK
        unexpected = {"code": "internal", "detail": f"the {job.kind} failed"}
        outcome = _failed(context, job, number, unexpected)
        # Somebody may have cancelled it, or deleted its dataset, meanwhile.
        if outcome == FAILED:
            log.exception("chunk %d of %s %d failed", number, *job)
        return outcome


def work_remotely(
    context: ServiceContext, asked: tuple[str, int, int], installation: str
) -> str:
    """As `work_on`, if this process looks at the database that is meant.

    A worker that cannot reach it gives the chunk back: the frames are not to blame.
    """
    try:
        with context.database.read() as session:
            found = LeaseRepository(session).installation()
        if found == installation:
            return work_on(context, *asked)
    except Exception as error:
        if not is_transient(error):
            raise
        log.warning("the database cannot be reached: %s", in_a_line(error))
        return GIVEN_BACK
    log.error("asked to work for another database than UNGHOST_DATABASE_URL's")
    return ELSEWHERE


def _told(error: AppError | FilterError) -> dict[str, Any]:
    return {"code": error.kind, "detail": error.detail}


def _failed(
    context: ServiceContext, job: Job, number: int, error: Mapping[str, Any]
) -> str:
    try:
        with context.database.write() as session:
            _AT_WORK[job.kind](session, job.id)
            LedgerRepository(session).fail(job, number, error)
    except JobStopped:
        return UNWANTED
    return FAILED
