"""A chunk during which processes die: deaths, suspects and quarantine.

A damaged library or a lack of memory can end a process without an error. Whoever tries
the same chunk again may die as well. So the chunk's row counts the processes that have
died while they worked on it (`Chunk.attempts`). Whoever stores a part of its result
sets the count to zero (`Attempt.reset`): work that goes on is never given up.

- After a death, the chunk is tried again **frame by frame**
  (`is_one_by_one`): each result is stored before the next frame begins. So if a process
  dies again, the first frame without a result is the **cause**.
- After three deaths (`MOST_ATTEMPTS`), that frame is put into **quarantine**: it
  becomes a chunk of its own, which is not tried again. The other frames of the chunk
  are tried again at once, and their count starts at zero.

All other chunks are processed; then the job fails with an error that names what is in
quarantine (`quarantine_error`). Chunks of a failed job that are in quarantine stay in
the database; the next run plans their frames anew.

**Who counts** depends on which process works on the chunk:

- A worker of a cluster: its driver is told that it died, and calls `count_death` for
  each chunk that the worker had begun, because any of them may be the cause. They are
  now **suspects**: each is submitted again while no other chunk is in progress
  (`JobDriver`), so that if a process dies again, this chunk is the cause.
- The driver itself: if there are no workers it executes all chunks, and always the
  final step. If it dies, nobody is left to count. So the driver adds one to the count
  when it begins a chunk (`Attempt.begin`). If it does not die, the count goes back to
  zero: with the first part of a result that is stored, or when the work ends
  (`Attempt.end`).

**Several frames in a row, each of which ends its process,** would end three processes
each. So if the frame just before a cause is in quarantine already, not only the cause
is put into quarantine, but all frames of the chunk that have no result
(`_follows_another`).

**An unreadable frame** ends no process: only the child processes that decode its images
die, or exceed their limits of time or memory. `refuse` puts its chunk into quarantine
once all its other frames are stored. If the chunk is tried frame by frame,
`refuse_frame` puts the frame into quarantine at once, and alone. If it stayed in the
chunk, the unreadable frame would be the first one without a result, and would be taken
for the cause when a later frame ends the process.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Final

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.catalog.frames import frame_before
from app.context import ServiceContext
from app.db.base import utc_now
from app.db.engine import once_committed
from app.db.tables import Chunk, JobRow
from app.db.transient import in_a_line, is_transient
from app.engine.chunk import Job
from app.jobs.chunks import FINAL_STEP, ChunkRepository, PlannedChunk
from app.jobs.kind import AnyTask, kind_of
from app.jobs.queries import require_open_job
from filter_core.errors import FilterError

MOST_ATTEMPTS: Final = 3
"""After so many dead processes, a chunk or a frame of it is put into quarantine."""
_PAUSE_S: Final = 0.5

log = logging.getLogger(__name__)


def is_one_by_one(task: AnyTask, chunk: Chunk) -> bool:
    """Whether a process has died during this chunk, which is now worked on again."""
    has_begun = 1 if task.is_counted else 0  # a driver counts the attempt that goes on
    deaths = chunk.attempts - has_begun
    return deaths > 0


def count_death(session: Session, job: Job, number: int) -> bool:
    """Count the death of a worker during a chunk; True if the chunk is to be retried.

    After `MOST_ATTEMPTS` the cause is put into quarantine, and the rest is retried.
    """
    chunk = ChunkRepository(session).find(job, number)
    if chunk is None or chunk.state != "waiting":
        return False
    chunk.attempts += 1
    if chunk.attempts >= MOST_ATTEMPTS:
        _quarantine_cause(session, job, chunk)
    session.flush()
    return chunk.state == "waiting"


class Attempt:
    """One attempt at a chunk.

    In the process that drives the job, `app.jobs.work` calls `begin` and `end`. In any
    process, the kinds of jobs call `reset`, by `Task.reset_attempts`.
    """

    def __init__(self, context: ServiceContext, job: Job, number: int) -> None:
        self.context, self.job, self.number = context, job, number
        self._is_counted = self._is_reset = False

    def begin(self) -> bool:
        """Count the attempt; False if the chunk is in quarantine.

        True also for a chunk that is done or gone, which the work itself finds out.
        After too many attempts, this puts the chunk into quarantine, or only the frame
        that is the cause: then the rest of the chunk is worked on. Raises JobStopped if
        the service is stopping, or the job is being cancelled.
        """
        self.context.engine.check(self.job)
        # Set before the commit, which may succeed although its response is lost.
        self._is_counted = True
        with self.context.database.write() as session:
            chunk = ChunkRepository(session).find(self.job, self.number)
            if chunk is None or chunk.state == "done":
                return True
            if chunk.attempts >= MOST_ATTEMPTS:
                _quarantine_cause(session, self.job, chunk)
            if chunk.state == "quarantined":
                return False
            chunk.attempts += 1
        return True

    def reset(self, session: Session) -> None:
        """Set the count to zero in a transaction that stores a part of the result.

        That a frame cannot be read is such a part, too. After the first call, the
        attempt of a driver is no longer counted: if its process dies later, the next
        attempt is a first one. Further calls do nothing.
        """
        if self._is_reset:
            return
        chunk = ChunkRepository(session).find(self.job, self.number)
        if chunk is not None and chunk.state == "waiting":
            chunk.attempts = 0
            session.flush()

        def reset() -> None:
            self._is_counted, self._is_reset = False, True

        once_committed(session, reset)

    def end(self) -> None:
        """Set the count to zero after work that failed but did not end the process.

        Otherwise this attempt would count as the death of a process. While the database
        is unavailable, this is retried until the service stops.
        """
        if not self._is_counted:
            return  # it was never begun, or is reset already
        while True:
            try:
                with self.context.database.write() as session:
                    self.reset(session)
                return
            except SQLAlchemyError as exc:
                stops = self.context.engine.stopping.wait(_PAUSE_S)
                if stops or not is_transient(exc):
                    log.warning(
                        "cannot reset chunk %d of %s %d: %s",
                        *(self.number, *self.job, in_a_line(exc)),
                    )
                    return


def refuse(session: Session, job: Job, number: int, why: FilterError) -> None:
    """Put a chunk into quarantine whose remaining frames cannot be read."""
    chunk = ChunkRepository(session).find(job, number)
    if chunk is not None and chunk.state == "waiting":
        _quarantine_refused(chunk, why)
        session.flush()


def refuse_frame(
    session: Session, job: Job, number: int, frame_id: int, why: FilterError
) -> None:
    """Put a frame that cannot be read into quarantine: the first without a result.

    Nothing is done if it is no longer the first: meanwhile it was measured or refused
    by another process, replaced or deleted.
    """
    chunk = ChunkRepository(session).find(job, number)
    if chunk is None or chunk.state != "waiting":
        return
    kind = kind_of(job)
    unfinished = kind.unfinished(
        session, require_open_job(session, kind.table, job.id), chunk
    )
    if unfinished[:1] != [frame_id]:
        return
    has_others = len(unfinished) > 1
    alone = _split_first(session, job, chunk, unfinished) if has_others else chunk
    _quarantine_refused(alone, why)
    session.flush()


def quarantine_error(session: Session, job: Job) -> dict[str, str] | None:
    """The error with which a job fails for what is in quarantine, which it names.

    None if nothing is, or if other processes have stored all its results meanwhile.
    """
    chunks = ChunkRepository(session).quarantined(job)
    refused = [chunk for chunk in chunks if chunk.error]
    deadly = [chunk for chunk in chunks if not chunk.error]
    errors = [chunk.error for chunk in refused if chunk.error]
    reasons = dict.fromkeys(str(error["detail"]) for error in errors)
    words = []
    if what := _unfinished_in(session, job, deadly):
        words.append(
            f"{what} crashed the process that worked on it {MOST_ATTEMPTS} times; "
            "the log of the process may show the cause"
        )
    if what := _unfinished_in(session, job, refused):
        words.append(f"{what} cannot be read: {'; '.join(reasons)}")
    return {"code": "quarantined", "detail": "; ".join(words)} if words else None


def _unfinished_in(session: Session, job: Job, chunks: Sequence[Chunk]) -> str:
    if not chunks:
        return ""
    kind = kind_of(job)
    if chunks[0].number == FINAL_STEP:
        return kind.final_step_words or ""
    return kind.name_unfinished(
        session, require_open_job(session, kind.table, job.id), chunks
    )


def _quarantine(chunk: Chunk) -> None:
    chunk.state, chunk.finished_at = "quarantined", utc_now()


def _quarantine_refused(chunk: Chunk, why: FilterError) -> None:
    chunk.error = {"code": why.kind, "detail": why.detail}
    _quarantine(chunk)


def _quarantine_cause(session: Session, job: Job, chunk: Chunk) -> None:
    """Put the frame at which the processes died into quarantine, or the whole chunk."""
    log.warning(
        "chunk %d of %s %d crashed its process %d times",
        *(chunk.number, *job, chunk.attempts),
    )
    kind = kind_of(job)
    row = require_open_job(session, kind.table, job.id)
    unfinished = kind.unfinished(session, row, chunk)
    if len(unfinished) < 2 or _follows_another(session, job, row, unfinished[0]):
        _quarantine(chunk)
        return
    cause = _split_first(session, job, chunk, unfinished)
    cause.attempts = chunk.attempts
    chunk.attempts = 0  # the rest of the chunk is tried again
    _quarantine(cause)


def _follows_another(session: Session, job: Job, row: JobRow, frame_id: int) -> bool:
    """Whether the frame before this one is in quarantine because it ended processes.

    Before it in the order of the dataset, without the frames that cannot be read.
    """
    unreadable: set[int] = set()
    deadly: set[int] = set()
    for chunk in ChunkRepository(session).quarantined(job):
        frames = unreadable if chunk.error else deadly
        frames.update(kind_of(job).unfinished(session, row, chunk))
    before = frame_before(session, row.dataset_id, frame_id)
    while before in unreadable:
        before = frame_before(session, row.dataset_id, before)
    return before in deadly


def _split_first(
    session: Session, job: Job, chunk: Chunk, unfinished: Sequence[int]
) -> Chunk:
    """Make the first of several unfinished frames a chunk of its own, and return it.

    The old chunk begins after that frame.
    """
    frame_id = unfinished[0]
    alone = PlannedChunk(frame_id, frame_id, 1)
    (number,) = ChunkRepository(session).plan(job, [alone])
    chunk.first_frame_id, chunk.frames = frame_id + 1, len(unfinished) - 1
    return session.get_one(Chunk, (*job, number))
