"""Drives a job: plans its chunks step by step, submits them to the engine, and ends it.

The engine executes chunks in threads of this process or on a cluster (`app.engine`).
Chunks may be executed more than once and in any order; only their rows in the database
count. So another process can continue at any moment. `app.jobs.leases` says which one
does, and `app.jobs.attempts` what happens to a chunk that ends its processes.
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
from app.engine.chunk import (
    ELSEWHERE,
    FAILED,
    QUARANTINED,
    RETURNED,
    UNWANTED,
    EngineAway,
    Job,
    JobStopped,
    WorkerDied,
)
from app.jobs.attempts import count_death, quarantine_error
from app.jobs.chunks import FINAL_STEP, ChunkRepository
from app.jobs.kind import READ_ROW_EVERY_S, AnyKind, is_open, kind_of
from app.jobs.leases import JobLease, Leases
from app.jobs.queries import close, require_open_job
from app.jobs.work import stored_error, unexpected_error, work_in_driver
from filter_core.errors import UnghostError

WAIT_S: Final = 0.1
"""How long the driver waits for a chunk to end before its other checks."""
_GIVEN_BACK: Final = (RETURNED, UNWANTED)
"""Outcomes of a chunk that is not done: the process that worked on it was stopping or
had no database (RETURNED), or found that the job has ended (UNWANTED)."""
LONGEST_PAUSE_S: Final = 8.0
"""The longest pause between two attempts to connect to the engine."""

log = logging.getLogger(__name__)


class ChunkFailed(Exception):
    """The error of a chunk, with which its job fails."""

    def __init__(self, error: Mapping[str, object]) -> None:
        super().__init__(error["detail"])
        self.error = dict(error)


def drive_job(context: ServiceContext, job: Job) -> bool:
    """Drive one job to its end, from the start or from where a former driver left it.

    Does nothing if another process drives it, or if another job has to end first: a
    run that activates waits for earlier ones of its dataset (`RunJobs.may_begin`).
    Returns whether the job has ended, here or elsewhere.
    """
    with context.one(Leases).driving(context.database, job) as lease:
        try:
            JobDriver(context, lease, kind_of(job)).drive()
        except JobStopped:
            pass
        except ChunkFailed as failed:
            log.warning("%s %d failed: %s", *job, failed)
            _fail(context, lease, failed.error)
        except UnghostError as error:
            log.warning("%s %d failed: %s", *job, error)
            _fail(context, lease, stored_error(error))
        except Exception as error:
            if is_transient(error):
                # Nothing is lost: the watchdog starts it again.
                log.warning("%s %d is interrupted: %s", *job, in_a_line(error))
                return False
            if _fail(context, lease, unexpected_error(job)):
                log.exception("%s %d failed", *job)
            else:
                # Somebody cancelled it, or deleted its dataset, between two statements.
                log.info(
                    "%s %d stopped: it has ended, or another process drives it", *job
                )
        finally:
            context.engine.clear_progress(job)
        with context.database.read() as session:
            return not is_open(session, job)


def _fail(
    context: ServiceContext, lease: JobLease, error: Mapping[str, object]
) -> bool:
    """End a job as failed; False if it has ended or another process drives it."""
    try:
        with context.database.write() as session:
            row = require_open_job(session, kind_of(lease.job).table, lease.job.id)
            # The failure may have been before the lease was taken.
            lease.take(session)
            close(session, row, "failed", error)
    except JobStopped:
        return False
    return True


@dataclass
class JobDriver:
    """Drives one job.

    A new driver continues with what the database says: it submits the chunks that its
    predecessor planned and that are not done, and plans more for frames that have no
    result and are in no chunk.

    `_to_send` are the numbers of chunks that wait for room in the engine, and
    `_in_flight` those that the engine works on. `_suspects` are chunks during which a
    process has died. Each of them is submitted alone, when nothing else is in flight
    (`app.jobs.attempts`). `_planned_up_to` is the id of the last frame that is in a
    chunk, and `_is_planned` whether every frame without a result is in one.
    """

    context: ServiceContext
    lease: JobLease
    kind: AnyKind
    _frames_per_chunk: int = 0
    _planned_up_to: int = 0
    _is_planned: bool = False
    _to_send: deque[int] = field(default_factory=deque)
    _suspects: deque[int] = field(default_factory=deque)
    _in_flight: dict[Future[str], int] = field(default_factory=dict)
    _row_read_at: float = 0.0

    def drive(self) -> None:
        """Start or resume the job, and drive it to its end.

        Raises JobStopped: the service is stopping, the job was cancelled or deleted,
        another process drives it, or another job has to end first; ChunkFailed: a chunk
        has failed. For quarantined chunks, after all others are done.
        """
        with self.context.database.write() as session:
            row = self._open_row(session)
            if not self.kind.may_begin(session, row):
                raise JobStopped(self.lease.job)
            self.lease.take(session)
            ChunkRepository(session).clear_errors(self.lease.job)
            self.kind.begin(session, row)
            row.state = "running"
            session.flush()
        while True:
            self._drive_chunks(row)
            if self.kind.final_step_words is None:
                # There is no final step: the only chunk of an export has ended the job.
                return
            self._drive_final_step()
            with self.context.database.read() as session:
                if not is_open(session, self.lease.job):
                    return
                # New frames have been stored meanwhile, which have to be planned too.
                row = self._open_row(session)

    def _open_row(self, session: Session) -> JobRow:
        """The job's row; raises JobStopped if the job has ended."""
        row: JobRow = require_open_job(session, self.kind.table, self.lease.job.id)
        return row

    def _drive_chunks(self, row: JobRow) -> None:
        """Plan and submit chunks until all are done."""
        engine = self.context.engine
        self._frames_per_chunk = engine.chunk_frames(row.total - row.done)
        with self.context.database.read() as session:
            chunks = ChunkRepository(session)
            self._to_send = deque(chunks.waiting(self.lease.job))
            self._planned_up_to = chunks.planned_up_to(self.lease.job)
        self._is_planned, here = False, partial(work_in_driver, self.context)
        try:
            while True:
                self._check()
                try:
                    while (number := self._next(row)) is not None:
                        future = engine.start_chunk(here, self.lease.job, number)
                        # A suspect remains one until it has ended.
                        if number not in self._suspects:
                            self._to_send.remove(number)
                        self._in_flight[future] = number
                except EngineAway:
                    self._reconnect()
                if not (self._in_flight or self._to_send or self._suspects):
                    break
                self._take_ended()
        finally:
            engine.release(list(self._in_flight))
        self._check_quarantine()

    def _drive_final_step(self) -> None:
        """Execute the final step, in this thread regardless of the engine.

        It does not end the job if frames were uploaded meanwhile: then `drive` plans
        them, and comes back.
        """
        with self.context.database.write() as session:
            self.lease.require(session)
            row = self._open_row(session)
            ChunkRepository(session).plan_final_step(self.lease.job, row.total)
        self._check()
        outcome = work_in_driver(self.context, *self.lease.job, FINAL_STEP)
        if outcome == QUARANTINED:
            self._check_quarantine()
        self._raise_failure(FINAL_STEP, outcome)
        if outcome in _GIVEN_BACK:
            self._wait_after_return()

    def _next(self, row: JobRow) -> int | None:
        """The chunk to submit next; None if none can be submitted now."""
        if self._suspects:
            # Alone, so that if a process dies again, this chunk is the cause.
            return None if self._in_flight else self._suspects[0]
        room = self.context.engine.most_in_flight - len(self._in_flight)
        if room > 0 and not self._to_send and not self._is_planned:
            size = {"most": room, "frames": self._frames_per_chunk}
            with self.context.database.read() as session:
                after = self._planned_up_to
                chunks = self.kind.plan(session, row, after=after, **size)
            self._is_planned = len(chunks) < room
            if chunks:
                self._planned_up_to = chunks[-1].last_frame_id
                with self.context.database.write() as session:
                    self.lease.require(session)
                    self._open_row(session)
                    planned = ChunkRepository(session).plan(self.lease.job, chunks)
                self._to_send.extend(planned)
        return self._to_send[0] if room > 0 and self._to_send else None

    def _take_ended(self) -> None:
        """Wait a moment for chunks to end, and handle their outcomes."""
        done, _ = wait(self._in_flight, WAIT_S, FIRST_COMPLETED)
        for future in done:
            number = self._in_flight.pop(future)
            try:
                outcome = self.context.engine.outcome(future)
            except WorkerDied as died:
                log.warning("chunk %d of %s %d: %s", number, *self.lease.job, died)
                self._drop_suspect(number)
                with self.context.database.write() as session:
                    self.lease.require(session)
                    is_retried = count_death(session, self.lease.job, number)
                if is_retried:
                    self._suspects.append(number)
            except EngineAway:
                self._send_again(number)
            else:
                self._raise_failure(number, outcome)
                if outcome in _GIVEN_BACK:
                    self._wait_after_return()
                    self._send_again(number)
                else:
                    self._drop_suspect(number)
        if not self.context.engine.is_connected():
            self._reconnect()

    def _raise_failure(self, number: int, outcome: str) -> None:
        """Raise ChunkFailed if the outcome of a chunk lets its job fail."""
        if outcome == FAILED:
            with self.context.database.read() as session:
                self._open_row(session)
                chunk = ChunkRepository(session).find(self.lease.job, number)
            stored = chunk.error if chunk else None
            raise ChunkFailed(stored or unexpected_error(self.lease.job))
        if outcome == ELSEWHERE:
            detail = (
                "a worker uses another database than the service; give both the same "
                "UNGHOST_DATABASE_URL"
            )
            raise ChunkFailed({"code": "worker_elsewhere", "detail": detail})

    def _wait_after_return(self) -> None:
        """Wait a moment after a chunk was given back, unless the job has ended."""
        self._row_read_at = 0.0  # read the job's row now
        self._check()
        self.context.engine.stopping.wait(WAIT_S)

    def _send_again(self, number: int) -> None:
        if number not in self._suspects:
            self._to_send.append(number)

    def _drop_suspect(self, number: int) -> None:
        if number in self._suspects:
            self._suspects.remove(number)

    def _check(self) -> None:
        self.context.engine.check(self.lease.job)
        self.lease.check()
        if time.monotonic() - self._row_read_at >= READ_ROW_EVERY_S:
            with self.context.database.read() as session:
                self._open_row(session)
            self._row_read_at = time.monotonic()

    def _reconnect(self) -> None:
        """Wait until the engine is connected, and submit again what is not done."""
        for number in self._in_flight.values():
            self._send_again(number)
        self._in_flight.clear()
        pause = WAIT_S
        while True:
            self._check()
            try:
                self.context.engine.connect()
            except EngineAway as away:
                log.warning("%s %d waits for workers: %s", *self.lease.job, away)
                self.context.engine.stopping.wait(pause)
                pause = min(2 * pause, LONGEST_PAUSE_S)
            else:
                break
        # Workers go on without the scheduler, and mark in the database what is done.
        with self.context.database.read() as session:
            waiting = set(ChunkRepository(session).waiting(self.lease.job))
        self._to_send = deque(number for number in self._to_send if number in waiting)
        self._suspects = deque(each for each in self._suspects if each in waiting)

    def _check_quarantine(self) -> None:
        with self.context.database.read() as session:
            error = quarantine_error(session, self.lease.job)
        if error is not None:
            raise ChunkFailed(error)
