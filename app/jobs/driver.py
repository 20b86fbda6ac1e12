"""Driving a job: its chunks are planned bit by bit, sent out, and looked after.

Chunks may be done more than once and in any order; what counts is what the database
says of them.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.tables import JobRow
from app.db.transient import in_a_line, is_transient
from app.engine import EngineAway, Job, JobStopped, WorkerDied
from app.engine.chunk import DONE, ELSEWHERE, FAILED, GIVEN_BACK, GIVEN_UP, UNWANTED
from app.errors import AppError
from app.jobs.kind import LOOK_AT_ROW_S, AnyKind, kind_of
from app.jobs.leases import JobLease, Leases
from app.jobs.queries import (
    OPEN,
    ChunkRepository,
    close,
    find_job,
    is_final,
    open_job,
)
from app.jobs.work import MOST_ATTEMPTS, stored_error, unexpected_error, work_here
from filter_core.errors import FilterError

LOOK_S: Final = 0.1
LONGEST_PAUSE_S: Final = 8.0
QUARANTINED: Final = "quarantined"

log = logging.getLogger(__name__)


class ChunkFailed(Exception):
    """What a job fails with, as its chunk says."""

    def __init__(self, error: Mapping[str, object]) -> None:
        super().__init__(error["detail"])
        self.error = dict(error)


def carry_out(context: ServiceContext, job: Job) -> bool:
    """Drive one job from its row to its end; safe to call again after a crash.

    Nothing happens if another process drives it, or if another job has to end first.
    True if the job is over.
    """
    with context.one(Leases).driving(context.database, job) as lease:
        try:
            JobDriver(context, lease, kind_of(job)).drive()
        except JobStopped:
            return _is_over(context, job)
        except ChunkFailed as failed:
            log.warning("%s %d failed: %s", *job, failed)
            _fail(context, lease, failed.error)
        except (AppError, FilterError) as error:
            log.warning("%s %d failed: %s", *job, error)
            _fail(context, lease, stored_error(error))
        except Exception as error:
            if is_transient(error):
                # Nothing is lost: the watchdog starts it again.
                log.warning("%s %d is cut off: %s", *job, in_a_line(error))
                return False
            if _fail(context, lease, unexpected_error(job)):
                raise
            # Somebody cancelled it, or deleted its dataset, between two statements.
            log.info("%s %d ended: nobody wants it any more", *job)
        finally:
            context.engine.clear_progress(job)
    return True


def _is_over(context: ServiceContext, job: Job) -> bool:
    with context.database.read() as session:
        row = find_job(session, kind_of(job).table, job.id)
        return row is None or row.state not in OPEN


def _fail(
    context: ServiceContext, lease: JobLease, error: Mapping[str, object]
) -> bool:
    """Note why a job failed; False if it is over, gone or another's already."""
    try:
        with context.database.write() as session:
            row = open_job(session, kind_of(lease.job).table, lease.job.id)
            lease.take(session)  # in case that it could not even begin
            lease.end(session)
            close(session, row, "failed", error)
    except JobStopped:
        return False
    return True


@dataclass
class JobDriver:
    """Carries out one job."""

    context: ServiceContext
    lease: JobLease
    kind: AnyKind
    _again: deque[int] = field(default_factory=deque)
    _suspects: deque[int] = field(default_factory=deque)
    _in_flight: dict[Future[str], int] = field(default_factory=dict)
    _after: int = 0
    _frames: int = 0
    _is_planned: bool = False
    _is_alone: bool = False
    _looked_at: float = 0.0

    def drive(self) -> None:
        """Begin or go on, until nothing is left to do.

        Raises
        ------
        JobStopped
            The service stops, nobody wants the job any more, another process drives it,
            or another job has to end first.
        ChunkFailed
            A chunk cannot be done; where processes died, all others are done first.
        """
        row = self._begin()
        while True:
            self._drive_chunks(row)
            if self.kind.final_step is None:
                return
            self._drive_final()
            if _is_over(self.context, self.lease.job):
                return
            # Frames came in meanwhile that are to be planned, too.
            with self.context.database.read() as session:
                row = self._row(session)

    def _begin(self) -> JobRow:
        with self.context.database.write() as session:
            row = self._row(session)
            if not self.kind.may_begin(session, row):
                raise JobStopped(self.lease.job)
            self.lease.take(session)
            ChunkRepository(session).begin_again(self.lease.job)
            self.kind.begin(session, row)
            row.state = "running"
            session.flush()
            return row

    def _row(self, session: Session) -> JobRow:
        row: JobRow = open_job(session, self.kind.table, self.lease.job.id)
        return row

    def _drive_chunks(self, row: JobRow) -> None:
        """Until every chunk is done."""
        self._frames = self.context.engine.chunk_frames(row.total - row.done)
        self._is_planned, self._after = False, 0
        with self.context.database.read() as session:
            chunks = ChunkRepository(session)
            self._again = deque(chunks.waiting(self.lease.job))
            # What is in quarantine is not planned once more, under another number.
            if self._again or chunks.quarantined(self.lease.job):
                self._after = chunks.last_frame(self.lease.job)
        try:
            while self._send(row):
                self._look()
        finally:
            self.context.engine.release(list(self._in_flight))
        self._check_quarantine()

    def _drive_final(self) -> None:
        """The final step, in this thread whatever the engine is.

        It is not done where it had to be given back: look, and begin again.
        """
        with self.context.database.write() as session:
            self.lease.require(session)
            row = self._row(session)
            number = ChunkRepository(session).plan_final(self.lease.job, row.total)
        self._check()
        outcome = work_here(self.context, *self.lease.job, number)
        if outcome == GIVEN_UP:
            self._check_quarantine()
        elif outcome != DONE:
            self._ended(number, outcome)

    def _send(self, row: JobRow) -> bool:
        """Send what there is room for; False once nothing is left."""
        self._check()
        try:
            while (number := self._next(row)) is not None:
                self._start(number)
        except EngineAway:
            self._reconnect()
        return bool(self._in_flight or self._again or self._suspects)

    def _next(self, row: JobRow) -> int | None:
        self._is_alone = self._is_alone and bool(self._in_flight)
        if self._suspects or self._is_alone:
            # Alone: if the process dies once more, this chunk and no other one did it.
            return None if self._in_flight else self._suspects[0]
        room = self.context.engine.window - len(self._in_flight)
        if room > 0 and not self._again and not self._is_planned:
            self._plan(row, room)
        return self._again[0] if room > 0 and self._again else None

    def _start(self, number: int) -> None:
        here = partial(work_here, self.context)
        engine = self.context.engine
        future = engine.start_chunk(here, self.lease.job, number)
        self._is_alone = bool(self._suspects)
        (self._suspects or self._again).popleft()
        self._in_flight[future] = number

    def _plan(self, row: JobRow, most: int) -> None:
        limits = {"after": self._after, "most": most, "frames": self._frames}
        with self.context.database.read() as session:
            spans = self.kind.plan(session, row, **limits)
        self._is_planned = len(spans) < most
        if not spans:
            return
        self._after = spans[-1].last_frame_id
        with self.context.database.write() as session:
            self.lease.require(session)
            self._row(session)
            self._again.extend(ChunkRepository(session).plan(self.lease.job, spans))

    def _look(self) -> None:
        done, _ = wait(self._in_flight, LOOK_S, FIRST_COMPLETED)
        for future in done:
            number = self._in_flight.pop(future)
            try:
                self._ended(number, self.context.engine.outcome(future))
            except WorkerDied as died:
                self._suspect(number, died)
            except EngineAway:
                self._again.append(number)
        if not self.context.engine.is_connected():
            self._reconnect()

    def _ended(self, number: int, outcome: str) -> None:
        if outcome == FAILED:
            raise ChunkFailed(self._error_of(number))
        if outcome == ELSEWHERE:
            detail = (
                "a worker looks at another database than the service; give both the "
                "same UNGHOST_DATABASE_URL"
            )
            raise ChunkFailed({"code": "worker_elsewhere", "detail": detail})
        if outcome in (GIVEN_BACK, UNWANTED):
            # If it is the job that nobody wants, its row says so.
            self._looked_at = 0.0
            self._check()
            self._again.append(number)
            self.context.engine.stopping.wait(LOOK_S)

    def _error_of(self, number: int) -> Mapping[str, object]:
        with self.context.database.read() as session:
            self._row(session)
            chunk = ChunkRepository(session).find(self.lease.job, number)
            return (chunk.error if chunk else None) or unexpected_error(self.lease.job)

    def _suspect(self, number: int, died: WorkerDied) -> None:
        log.warning("chunk %d of %s %d: %s", number, *self.lease.job, died)
        with self.context.database.write() as session:
            self.lease.require(session)
            chunks = ChunkRepository(session)
            if chunks.suspect(self.lease.job, number, MOST_ATTEMPTS):
                self._suspects.append(number)

    def _check(self) -> None:
        self.context.engine.check(self.lease.job)
        self.lease.check()
        if time.monotonic() - self._looked_at >= LOOK_AT_ROW_S:
            with self.context.database.read() as session:
                self._row(session)
            self._looked_at = time.monotonic()

    def _reconnect(self) -> None:
        """Wait for the engine as long as it takes, and send again what is not done."""
        self._again.extendleft(self._in_flight.values())
        self._in_flight.clear()
        pause = LOOK_S
        while True:
            self._check()
            try:
                self.context.engine.connect()
            except EngineAway as away:
                log.warning("%s %d waits for its engine: %s", *self.lease.job, away)
                self.context.engine.stopping.wait(pause)
                pause = min(2 * pause, LONGEST_PAUSE_S)
            else:
                break
        # Workers go on without it, and note what they have done.
        with self.context.database.read() as session:
            waiting = set(ChunkRepository(session).waiting(self.lease.job))
        self._again = deque(number for number in self._again if number in waiting)

    def _check_quarantine(self) -> None:
        with self.context.database.read() as session:
            given_up = ChunkRepository(session).quarantined(self.lease.job)
            if not given_up:
                return
            if is_final(given_up[0].number):
                what = self.kind.final_step
            else:
                what = self.kind.name_left(session, self._row(session), given_up)
        if what:
            detail = (
                f"{what} ended the process that was at it {MOST_ATTEMPTS} times; the "
                "log of the process may say why"
            )
            raise ChunkFailed({"code": QUARANTINED, "detail": detail})
