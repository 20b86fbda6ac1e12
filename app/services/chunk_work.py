"""Working on one chunk of a job, in the driver's process or in a worker's.

What goes wrong is written into the chunk's row: errors never travel with an answer.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any, Final

from app.db.passing import in_a_line, is_passing
from app.engine import Job, JobStopped
from app.engine.jobs import DONE, ELSEWHERE, FAILED, GIVEN_BACK, UNWANTED
from app.errors import AppError
from app.repositories.leases import LeaseRepository
from app.repositories.ledger import LedgerRepository
from app.services.context import ServiceContext
from app.services.export_writing import export_at_work, write_chunk
from app.services.run_measuring import measure_chunk
from app.services.run_states import run_at_work
from filter_core.errors import FilterError

Work = Callable[[ServiceContext, int, int], None]
_WORK: Final[Mapping[str, Work]] = {"run": measure_chunk, "export": write_chunk}
_AT_WORK: Final[Mapping[str, Callable[..., object]]] = {
    "run": run_at_work,
    "export": export_at_work,
}

log = logging.getLogger(__name__)


def work_on(context: ServiceContext, kind: str, job_id: int, number: int) -> str:
    """Work on a chunk, whatever comes; how it ended."""
    job = Job(kind, job_id)
    try:
        _WORK[kind](context, job_id, number)
    except JobStopped:
        return GIVEN_BACK if context.engine.stopping.is_set() else UNWANTED
    except (AppError, FilterError) as error:
        return _failed(context, job, number, _told(error))
    except Exception as error:
        if is_passing(error):
            log.warning("chunk %d of %s %d: %s", number, *job, in_a_line(error))
            return GIVEN_BACK
        outcome = _failed(
            context, job, number, {"code": "internal", "detail": f"the {kind} failed"}
        )
        # Somebody may have cancelled it, or deleted its dataset, meanwhile.
        if outcome == FAILED:
            log.exception("chunk %d of %s %d failed", number, kind, job_id)
        return outcome
    return DONE


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
        if not is_passing(error):
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
