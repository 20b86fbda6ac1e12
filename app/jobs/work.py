"""Processes one chunk of a job, in the process that drives it or in a worker.

The functions return the outcome, one of the constants of `app.engine.chunk`. An error
that ends the job is written into the chunk's row; one that may pass, such as a lost
connection, is logged, and the chunk is returned.

If the process dies instead, there is no outcome: `app.jobs.attempts`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

from app.context import ServiceContext
from app.db.transient import in_a_line, is_transient
from app.engine import chunk
from app.jobs.attempts import Attempt
from app.jobs.chunks import FINAL_STEP, ChunkRepository
from app.jobs.kind import AnyTask, Task, kind_of
from app.jobs.queries import installation_id
from filter_core.errors import UnghostError

log = logging.getLogger(__name__)


def work_on_chunk(context: ServiceContext, kind: str, job_id: int, number: int) -> str:
    """Process a chunk in any process; returns the outcome.

    `work_in_driver` and `work_in_worker` add checks for their process.
    """
    task = _task(Attempt(context, chunk.Job(kind, job_id), number))
    return _outcome(task, lambda: _do(task))


def work_in_driver(context: ServiceContext, kind: str, job_id: int, number: int) -> str:
    """As `work_on_chunk`, in the process that drives the job, which counts its attempt.

    The outcome is QUARANTINED if the chunk is not to be worked on.
    """
    attempt = Attempt(context, chunk.Job(kind, job_id), number)
    task = _task(attempt, is_counted=True)
    outcome = _outcome(
        task, lambda: _do(task) if attempt.begin() else chunk.QUARANTINED
    )
    # A chunk that is done or in quarantine is not begun again: its count is of no use.
    # (A final step that has found new frames is begun again, and has reset its count.)
    if outcome not in (chunk.DONE, chunk.QUARANTINED):
        attempt.end()
    return outcome


def _task(attempt: Attempt, *, is_counted: bool = False) -> AnyTask:
    context, job, number = attempt.context, attempt.job, attempt.number
    return Task(context, kind_of(job), job, number, attempt.reset, is_counted)


def _do(task: AnyTask) -> str:
    try:
        if task.number == FINAL_STEP:
            task.kind.finish(task)
        else:
            task.kind.work(task)
    finally:
        task.stop()
    return chunk.DONE


def _outcome(task: AnyTask, work: Callable[[], str]) -> str:
    try:
        return work()
    except chunk.JobStopped:
        return (
            chunk.RETURNED if task.context.engine.stopping.is_set() else chunk.UNWANTED
        )
    except UnghostError as error:
        return _failed(task, stored_error(error))
    except Exception as error:
        if is_transient(error):
            log.warning("%s: %s", _named(task), in_a_line(error))
            return chunk.RETURNED
        outcome = _failed(task, unexpected_error(task.job))
        # Not if the job was cancelled, or its dataset deleted, in the meantime.
        if outcome == chunk.FAILED:
            log.exception("%s failed", _named(task))
        return outcome


def work_in_worker(
    context: ServiceContext, place: tuple[str, int, int], installation: str
) -> str:
    """As `work_on_chunk`, in a worker.

    `place` names the kind and the id of the job, and the number of the chunk;
    `installation` is the id of the driver's database. If the worker's is another one,
    the outcome is ELSEWHERE, and the chunk is not worked on. It is RETURNED if the
    worker cannot reach the database: the driver sends the chunk again, and this is no
    attempt.
    """
    try:
        with context.database.read() as session:
            is_same = installation_id(session) == installation
        if is_same:
            return work_on_chunk(context, *place)
    except Exception as error:
        if not is_transient(error):
            raise
        log.warning("the database cannot be reached: %s", in_a_line(error))
        return chunk.RETURNED
    log.error("got a chunk of another database than that of UNGHOST_DATABASE_URL")
    return chunk.ELSEWHERE


def stored_error(error: UnghostError) -> dict[str, str]:
    """An expected error, as it is stored in a job's row."""
    return {"code": error.kind, "detail": error.detail}


def unexpected_error(job: chunk.Job) -> dict[str, str]:
    """Any other error, as it is stored in a job's row; the log has the details."""
    return {"code": "internal", "detail": f"the {job.kind} failed"}


def _failed(task: AnyTask, error: Mapping[str, object]) -> str:
    try:
        with task.context.database.write() as session:
            task.row(session)
            ChunkRepository(session).fail(task.job, task.number, error)
    except chunk.JobStopped:
        return chunk.UNWANTED
    return chunk.FAILED


def _named(task: AnyTask) -> str:
    return f"chunk {task.number} of {task.job.kind} {task.job.id}"
