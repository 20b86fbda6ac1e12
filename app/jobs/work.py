"""Working on one chunk of a job, in the driver's process or in a worker's.

What goes wrong is written into the chunk's row: errors never travel with an answer.

Where the process that drives a job works on a chunk itself, nobody is left to note
that it ended: so it writes the attempt down before it begins. That it lives is seen by
what it stores; only processes that stored nothing of a chunk count against the chunk.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any, Final

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.engine import once_committed
from app.db.tables import Chunk
from app.db.transient import in_a_line, is_transient
from app.engine import Job, JobStopped
from app.engine.chunk import DONE, ELSEWHERE, FAILED, GIVEN_BACK, GIVEN_UP, UNWANTED
from app.errors import AppError
from app.jobs.queries import DECISION, ChunkRepository, LeaseRepository
from app.services.export_writing import export_at_work, write_chunk
from app.services.run_measuring import Stored, frames_left, measure_chunk
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
            ChunkRepository(session).fail(job, number, error)
    except JobStopped:
        return UNWANTED
    return FAILED


MOST_ATTEMPTS: Final = 3
"""Processes in a row that may end at a chunk before nobody tries it again."""
_PAUSE_S: Final = 0.5


class Attempt:
    """One attempt of this process at a chunk, from its row to its end."""

    def __init__(self, context: ServiceContext, job: Job, number: int) -> None:
        self._context, self._job, self._number = context, job, number
        self._is_noted = False

    def begin(self) -> bool:
        """Write it down; False if there were too many.

        Raises
        ------
        JobStopped
            The service stops, or nobody wants the job any more.
        """
        self._context.engine.check(self._job)
        self._is_noted = True  # also if the answer to the commit is lost
        with self._context.database.write() as session:
            ledger = ChunkRepository(session)
            chunk = ledger.find(self._job, self._number)
            if chunk is None or chunk.state == "done":
                return True
            if chunk.attempts >= MOST_ATTEMPTS:
                log.warning(
                    "chunk %d of %s %d ended its process %d times",
                    *(self._number, *self._job, chunk.attempts),
                )
                _give_up(session, self._job, chunk)
            if chunk.state == "quarantined":
                return False
            ledger.attempt(chunk)
        return True

    def forget(self, session: Session) -> None:
        """Something of the chunk is stored: what ends the process now is not this."""
        if self._is_noted:
            ChunkRepository(session).forget_attempts(self._job, self._number)
            once_committed(session, self._forgotten)

    def end(self) -> None:
        """The work ended, and the process did not.

        Whoever tries again in this process must not count twice: a database that is
        away is waited for, until the service stops.
        """
        while self._is_noted:
            try:
                with self._context.database.write() as session:
                    self.forget(session)
            except SQLAlchemyError as exc:
                stops = self._context.engine.stopping.wait(_PAUSE_S)
                if stops or not is_transient(exc):
                    told = self._number, *self._job, in_a_line(exc)
                    log.warning("an attempt at chunk %d of %s %d stays: %s", *told)
                    return

    def _forgotten(self) -> None:
        self._is_noted = False


def _give_up(session: Session, job: Job, chunk: Chunk) -> None:
    """Put what kills into quarantine: one frame, unless its neighbour is there too.

    Where pictures kill that stand side by side, the rest of the chunk goes with them:
    each of them alone would cost as many processes again.
    """
    ledger = ChunkRepository(session)
    left = frames_left(session, job.id, chunk) if job.kind == "run" else []
    beside = {one.last_frame_id + 1 for one in ledger.quarantined(job)}
    if len(left) < 2 or left[0] in beside:
        ledger.give_up(chunk)
    else:
        ledger.set_aside(chunk, left[0], len(left))
