"""The interface of a kind of job, and the task that is passed to it.

There are two kinds of jobs: runs and exports. The rest of this package treats them
alike. A kind is registered when the process starts, and looked up by its name
(`Job.kind`), which chunks and leases of its jobs contain. The `kind` in the row of a
run is something else: whether the run measures or only decides.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Generic, Protocol, TypeAlias, TypeVar

from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.tables import Chunk
from app.engine.chunk import Job, JobStopped
from app.errors import StorageAway
from app.jobs.chunks import FINAL_STEP, ChunkRepository, PlannedChunk
from app.jobs.queries import (
    OPEN,
    Row,
    close,
    find_job,
    open_jobs,
    require_open_job,
    tell_done,
)
from unghost.wire.runs import Export, Run

READ_ROW_EVERY_S: Final = 0.5
"""How often a task reads its job's row, to notice that the job has ended."""
TELL_EVERY_S: Final = 0.5
"""How often a task stores its progress."""
PAUSES_S: Final = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
"""Seconds between retries while the file storage is unavailable.

A job survives an outage of half a minute; requests do not wait that long.
"""
_CHECK_EVERY_S: Final = 0.25
_T = TypeVar("_T")

Described: TypeAlias = Run | Export
"""A job as responses show it."""


class JobKind(Protocol[Row]):
    """One kind of job, whose work is divided into chunks of frames."""

    table: type[Row]
    """Its rows; `table.job_kind` is the kind's name."""
    final_step_words: str | None
    """A phrase for the step after all chunks, such as "deciding its boxes", used in
    error messages; None for a kind whose only chunk ends the job itself.

    The final step is a chunk, too, with the number 0 (`app.jobs.chunks`). The driver
    executes it itself, when all other chunks are done."""

    def may_begin(self, session: Session, row: Row) -> bool:
        """Whether the job may begin: False if another job has to end first."""

    def begin(self, session: Session, row: Row) -> None:
        """Store the amount of work in the row.

        Called in the transaction in which a driver takes the job: again by the next
        driver if this one dies. `row.state` is "queued" only the first time.
        """

    def plan(
        self, session: Session, row: Row, *, after: int, most: int, frames: int
    ) -> list[PlannedChunk]:
        """Up to `most` chunks of `frames` frames each, after the frame id `after`.

        Fewer than `most` mean that nothing more is to be planned. The row was read when
        the job began.
        """

    def work(self, task: Task[Row]) -> None:
        """Process one chunk, in this process or in a worker.

        Raises JobStopped if it was stopped before the end; results stored so far stay.
        """

    def finish(self, task: Task[Row]) -> None:
        """The final step: ends the job, or returns if there are new frames to plan.

        Raises JobStopped if the job is cancelled, or the service is stopping.
        """

    def unfinished(self, session: Session, row: Row, chunk: Chunk) -> list[int]:
        """Ids of the frames of a chunk that have no result yet.

        Empty for a chunk without frames of its own.
        """

    def name_unfinished(
        self, session: Session, row: Row, chunks: Sequence[Chunk]
    ) -> str:
        """The frames of these chunks without a result, as the subject of a sentence.

        Empty if other processes have stored all results meanwhile.
        """

    def describe(
        self, context: ServiceContext, session: Session, row: Row
    ) -> Described:
        """A job as responses show it."""


AnyKind: TypeAlias = JobKind[Any]
_KINDS: Final[dict[str, AnyKind]] = {}


def register(*kinds: AnyKind) -> None:
    """Register kinds in this process; a later one of the same name replaces it."""
    _KINDS.update({kind.table.job_kind: kind for kind in kinds})


def kinds() -> tuple[AnyKind, ...]:
    """All kinds, in the order in which they were registered."""
    return tuple(_KINDS.values())


def kind_of(job: Job) -> AnyKind:
    return _KINDS[job.kind]


def is_open(session: Session, job: Job) -> bool:
    """Whether a job is queued or running: it has neither ended nor been deleted.

    False for a lease of something else, such as a hook.
    """
    kind = _KINDS.get(job.kind)
    row = None if kind is None else find_job(session, kind.table, job.id)
    return row is not None and row.state in OPEN


def all_open_jobs(session: Session, dataset_id: int | None = None) -> list[Job]:
    """All open jobs, or those of a dataset, kind by kind, oldest first."""
    return [
        job for kind in kinds() for job in open_jobs(session, kind.table, dataset_id)
    ]


@dataclass
class Task(Generic[Row]):
    """One chunk of a job, as it is passed to a kind's `work` and `finish`.

    `reset_attempts` is called in each transaction that stores a part of the result, or
    finds that more has to be measured first. `is_counted`: whether this attempt is in
    the count of the chunk's row already (`app.jobs.attempts`).
    """

    context: ServiceContext
    kind: JobKind[Row]
    job: Job
    number: int
    reset_attempts: Callable[[Session], None]
    is_counted: bool = False
    _is_over: threading.Event = field(default_factory=threading.Event)
    _row_read_at: float = field(default_factory=time.monotonic)
    _told_at: float = field(default_factory=time.monotonic)

    def row(self, session: Session) -> Row:
        """The job's row; raises JobStopped if the job has ended."""
        return require_open_job(session, self.kind.table, self.job.id)

    def chunk(self, session: Session) -> Chunk | None:
        """The chunk's row, unless its job has been removed."""
        return ChunkRepository(session).find(self.job, self.number)

    def check(self) -> None:
        """Raise `JobStopped` if the work is no longer needed or must pause.

        That is if the service is stopping, or the job is being cancelled or has ended.
        The job's row is read only twice a second, so that every frame can call this.
        """
        if self._is_over.is_set():
            raise JobStopped(self.job)
        self.context.engine.check(self.job)
        if time.monotonic() - self._row_read_at >= READ_ROW_EVERY_S:
            with self.context.database.read() as session:
                if self.number != FINAL_STEP:
                    self.row(session)
                # A cancellation cannot change the job's row before the final step's
                # transaction has ended. So it deletes the row of the step (its chunk).
                elif self.chunk(session) is None:
                    raise JobStopped(self.job)
            self._row_read_at = time.monotonic()

    def report(self, done: int) -> None:
        """Publish how many frames are done, for clients that watch.

        Nobody can see rows of the final step until it commits. So on PostgreSQL the
        number is written in a separate transaction; on SQLite, which has one writer, it
        is kept in memory of this process.
        """
        if self.number == FINAL_STEP:
            self.context.engine.report(self.job, done)
            if self.context.database.has_one_writer:
                return
        if time.monotonic() - self._told_at >= TELL_EVERY_S:
            with self.context.database.write_out_of_turn() as session:
                tell_done(session, self.kind.table, self.job.id, done)
            self._told_at = time.monotonic()

    def retry_unavailable(self, use_storage: Callable[[], _T]) -> _T:
        """The result of `use_storage`, retried while the file storage is unavailable.

        Raises JobStopped as `check` does, during a pause between two attempts.
        """
        for pause_s in PAUSES_S:
            try:
                return use_storage()
            except StorageAway:
                until = time.monotonic() + pause_s
                while (left := until - time.monotonic()) > 0:
                    self.check()
                    self.context.engine.stopping.wait(min(left, _CHECK_EVERY_S))
        return use_storage()

    def end_job(self, session: Session) -> None:
        """End the job as done in this transaction; JobStopped if it has ended."""
        close(session, self.row(session), "done")

    def stop(self) -> None:
        """Make `check` raise in all threads of this task, so that they end."""
        self._is_over.set()


AnyTask: TypeAlias = Task[Any]
