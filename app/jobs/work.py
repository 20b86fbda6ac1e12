"""Processes one chunk of a job, in the process that drives it or in a worker.

The functions return the outcome, one of the constants of `app.engine.chunk`. An error
that ends the job is written into the chunk's row; one that may pass, such as a lost
connection, is logged, and the chunk is returned.

If a worker dies, the driver counts an attempt in the chunk's row. If the driver itself
dies while it works on a chunk, nobody can count that. So it counts the attempt before
it begins the chunk, and sets the count to zero as soon as a part of the result is
stored. The count then says how many attempts in a row have ended their process and
stored nothing.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Final

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.engine import once_committed
from app.db.tables import Chunk
from app.db.transient import in_a_line, is_transient
from app.engine import Job, JobStopped
from app.engine.chunk import DONE, ELSEWHERE, FAILED, QUARANTINED, RETURNED, UNWANTED
from app.errors import AppError
from app.jobs.kind import AnyTask, Task, kind_of
from app.jobs.queries import (
    ChunkRepository,
    LeaseRepository,
    is_final,
    open_job,
)
from filter_core.errors import FilterError

MOST_ATTEMPTS: Final = 3
"""After as many dead processes the frame at which they died, or the whole chunk, is
quarantined."""
_PAUSE_S: Final = 0.5

log = logging.getLogger(__name__)


def work_on_chunk(context: ServiceContext, kind: str, job_id: int, number: int) -> str:
    """Process a chunk in any process; returns the outcome.

    `work_in_driver` and `work_in_worker` add checks for their process.
    """
    task = _task(context, Job(kind, job_id), number)
    return _outcome(task, lambda: _do(task))


def work_in_driver(context: ServiceContext, kind: str, job_id: int, number: int) -> str:
    """As `work_on_chunk`, in the process that drives the job.

    The attempt is counted in the chunk's row before the work begins, since no other
    process can count it if this one dies. If there were too many, the frame at which
    the processes died is quarantined, or the chunk, which then is not worked on.
    """
    task = _task(context, Job(kind, job_id), number)
    attempt = Attempt(context, task.job, number)
    task.on_stored = attempt.forget
    outcome = _outcome(task, lambda: _do(task) if attempt.begin() else QUARANTINED)
    if outcome not in (DONE, QUARANTINED):
        attempt.end()
    return outcome


def _task(context: ServiceContext, job: Job, number: int) -> AnyTask:
    return Task(context, kind_of(job), job, number)


def _do(task: AnyTask) -> str:
    try:
        if is_final(task.number):
            task.kind.finish(task)
        else:
            task.kind.work(task)
    finally:
        task.stop()
    return DONE


def _outcome(task: AnyTask, work: Callable[[], str]) -> str:
    try:
        return work()
    except JobStopped:
        return RETURNED if task.context.engine.stopping.is_set() else UNWANTED
    except (AppError, FilterError) as error:
        return _failed(task, stored_error(error))
    except Exception as error:
        if is_transient(error):
            log.warning("%s: %s", _named(task), in_a_line(error))
            return RETURNED
        outcome = _failed(task, unexpected_error(task.job))
        # Not if the job was cancelled, or its dataset deleted, in the meantime.
        if outcome == FAILED:
            log.exception("%s failed", _named(task))
        return outcome


def work_in_worker(
    context: ServiceContext, asked: tuple[str, int, int], installation: str
) -> str:
    """As `work_on_chunk`, in a worker.

    Parameters
    ----------
    context : ServiceContext
    asked : tuple of str, int and int
        The kind and the id of the job, and the number of the chunk.
    installation : str
        The id of the driver's database. If the worker's is another one, the outcome is
        ELSEWHERE, and the chunk is not worked on.

    Returns
    -------
    str
        The outcome. RETURNED if the worker cannot reach the database: the driver sends
        the chunk again, and this is no attempt.
    """
    try:
        with context.database.read() as session:
            found = LeaseRepository(session).installation()
        if found == installation:
            return work_on_chunk(context, *asked)
    except Exception as error:
        if not is_transient(error):
            raise
        log.warning("the database cannot be reached: %s", in_a_line(error))
        return RETURNED
    log.error("got a chunk of another database than that of UNGHOST_DATABASE_URL")
    return ELSEWHERE


def stored_error(error: AppError | FilterError) -> dict[str, str]:
    """An expected error, as it is stored in a job's row."""
    return {"code": error.kind, "detail": error.detail}


def unexpected_error(job: Job) -> dict[str, str]:
    """Any other error, as it is stored in a job's row; the log has the details."""
    return {"code": "internal", "detail": f"the {job.kind} failed"}


def _failed(task: AnyTask, error: Mapping[str, object]) -> str:
    try:
        with task.context.database.write() as session:
            task.row(session)
            ChunkRepository(session).fail(task.job, task.number, error)
    except JobStopped:
        return UNWANTED
    return FAILED


def _named(task: AnyTask) -> str:
    return f"chunk {task.number} of {task.job.kind} {task.job.id}"


class Attempt:
    """One attempt of this process at a chunk, which is counted in the chunk's row."""

    def __init__(self, context: ServiceContext, job: Job, number: int) -> None:
        self._context, self._job, self._number = context, job, number
        self._is_noted = False

    def begin(self) -> bool:
        """Count the attempt; False if the chunk is quarantined.

        After too many attempts the chunk is quarantined, or only the frame at which the
        processes died: then the rest of the chunk is worked on.

        Raises
        ------
        JobStopped
            The service is stopping, or the job is being cancelled.
        """
        self._context.engine.check(self._job)
        # Before the commit: it may succeed although its response is lost.
        self._is_noted = True
        with self._context.database.write() as session:
            chunks = ChunkRepository(session)
            chunk = chunks.find(self._job, self._number)
            if chunk is None or chunk.state == "done":
                return True
            if chunk.attempts >= MOST_ATTEMPTS:
                log.warning(
                    "chunk %d of %s %d ended its process %d times",
                    *(self._number, *self._job, chunk.attempts),
                )
                _quarantine(session, self._job, chunk)
            if chunk.state == "quarantined":
                return False
            chunks.attempt(chunk)
        return True

    def forget(self, session: Session) -> None:
        """Set the attempts to zero in a transaction that stores a part of a result."""
        if self._is_noted:
            ChunkRepository(session).forget_attempts(self._job, self._number)
            once_committed(session, self._forgotten)

    def end(self) -> None:
        """Set the attempts to zero after work that failed but did not end the process.

        Otherwise this attempt would count as the death of a process. While the database
        is unavailable, this is retried until the service stops.
        """
        while self._is_noted:
            try:
                with self._context.database.write() as session:
                    self.forget(session)
            except SQLAlchemyError as exc:
                stops = self._context.engine.stopping.wait(_PAUSE_S)
                if stops or not is_transient(exc):
                    told = self._number, *self._job, in_a_line(exc)
                    log.warning("cannot reset chunk %d of %s %d: %s", *told)
                    return

    def _forgotten(self) -> None:
        self._is_noted = False


def _quarantine(session: Session, job: Job, chunk: Chunk) -> None:
    """Quarantine the frame at which the process died: the first without a result.

    From its second attempt on, a chunk is processed frame by frame. If the frame before
    this one is quarantined already, the rest of the chunk is quarantined, too;
    otherwise each of many such frames in a row would end `MOST_ATTEMPTS` processes.
    Results that are stored stay.
    """
    chunks, kind = ChunkRepository(session), kind_of(job)
    unfinished = kind.unfinished(session, open_job(session, kind.table, job.id), chunk)
    after_quarantined = {one.last_frame_id + 1 for one in chunks.quarantined(job)}
    if len(unfinished) < 2 or unfinished[0] in after_quarantined:
        chunks.quarantine(chunk)
    else:
        chunks.quarantine_frame(chunk, unfinished[0], len(unfinished))
