"""What a kind of job declares, and the task that it is given to work on.

The rest of this room treats all jobs alike. A kind is registered when the process
starts, and is found by its name, which stands in the chunks and leases of its jobs.
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
from app.engine import Job, JobStopped
from app.errors import StorageAway
from app.jobs.queries import (
    ChunkRepository,
    Row,
    Span,
    close,
    is_final,
    open_job,
    tell_done,
)
from filter_core.errors import FilterError

READ_ROW_EVERY_S: Final = 0.5
"""How often a task reads its job's row, to notice that the job has ended."""
TELL_EVERY_S: Final = 0.5
"""How often a task writes down how far it is."""
PAUSES_S: Final = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
"""Seconds between attempts to reach a store.

A job goes on after the store was away for half a minute; requests do not wait so long.
"""
_CHECK_EVERY_S: Final = 0.25
_T = TypeVar("_T")


class Described(Protocol):
    """A job as responses show it: a model of the wire."""

    @property
    def state(self) -> str:
        """One of the states of `JobRow`."""

    @property
    def total(self) -> int:
        """How many frames there are to work on."""

    @property
    def done(self) -> int:
        """How many of them are done."""

    @property
    def finished(self) -> bool:
        """True when nothing will happen to it any more."""

    def model_dump_json(self) -> str:
        """As it is written into a response."""


class JobKind(Protocol[Row]):
    """One kind of job: what there is to do, cut into chunks of frames."""

    table: type[Row]
    """Its rows; `table.job_kind` is the kind's name."""
    final_step: str | None
    """What is done once all chunks are, such as "deciding its boxes"; None of a kind
    whose only chunk ends the job itself. It stands in the words of a failure."""

    def may_begin(self, session: Session, row: Row) -> bool:
        """Whether no other job has to end first."""

    def begin(self, session: Session, row: Row) -> None:
        """Note what there is to do; `row.state` is "queued" only the first time.

        Called in the transaction in which a driver takes the job, again after a crash.
        """

    def plan(
        self, session: Session, row: Row, *, after: int, most: int, frames: int
    ) -> list[Span]:
        """Up to `most` chunks of `frames` frames each, behind the frame id `after`.

        Fewer than `most` say that there is nothing more to plan. The row was read when
        the job began.
        """

    def work(self, task: Task[Row]) -> None:
        """Work on one chunk, here or in a worker.

        Raises
        ------
        JobStopped
            Before all was done; what is stored stays.
        """

    def finish(self, task: Task[Row]) -> None:
        """The final step: ends the job, or returns if there is more to plan by now.

        Raises
        ------
        JobStopped
            It is cancelled, or the service stops.
        """

    def unfinished(self, session: Session, row: Row, chunk: Chunk) -> list[int]:
        """Ids of the frames of a chunk that have no result; none if it has no frames of
        its own."""

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
    """Make kinds known to this process; a later one of the same name counts."""
    _KINDS.update({kind.table.job_kind: kind for kind in kinds})


def kinds() -> tuple[AnyKind, ...]:
    """All kinds, in the order in which they were registered."""
    return tuple(_KINDS.values())


def kind_of(job: Job) -> AnyKind:
    """The kind of a job."""
    return _KINDS[job.kind]


def _ignore(_session: Session) -> None:
    """Nothing: the driver counts the attempts of a worker."""


@dataclass
class Task(Generic[Row]):
    """One chunk of a job, as a kind's `work` and `finish` see it.

    `on_stored` is called in each transaction that stores a part of the result.
    """

    context: ServiceContext
    kind: JobKind[Row]
    job: Job
    number: int
    on_stored: Callable[[Session], None] = _ignore
    _is_over: threading.Event = field(default_factory=threading.Event)
    _row_read_at: float = field(default_factory=time.monotonic)
    _told_at: float = field(default_factory=time.monotonic)

    def row(self, session: Session) -> Row:
        """The job's row; JobStopped if it is not open any more."""
        return open_job(session, self.kind.table, self.job.id)

    def chunk(self, session: Session) -> Chunk | None:
        """The chunk's row, unless its job was forgotten."""
        return ChunkRepository(session).find(self.job, self.number)

    def check(self) -> None:
        """Raise `JobStopped` if the work would be in vain.

        The service stops, somebody cancels the job, or the job is over; for the last
        one its row is read twice a second. Cheap enough to be called for every frame.
        """
        if self._is_over.is_set():
            raise JobStopped(self.job)
        self.context.engine.check(self.job)
        if time.monotonic() - self._row_read_at >= READ_ROW_EVERY_S:
            self._require_open()
            self._row_read_at = time.monotonic()

    def check_wanted(self) -> None:
        """As `check`, but goes on while the service stops, so that work is kept."""
        self.context.engine.check_wanted(self.job)

    def stored(self, session: Session) -> None:
        """A part of the result is stored with this transaction."""
        self.on_stored(session)

    def report(self, done: int) -> None:
        """Say how many frames are done, for those who watch.

        Rows that the final step writes are seen by nobody until it commits. On
        PostgreSQL the number is written in a separate transaction; on SQLite only the
        memory of this process can tell it.
        """
        final = is_final(self.number)
        if final:
            self.context.engine.report(self.job, done)
        if final and self.context.database.has_one_writer:
            return
        if time.monotonic() - self._told_at >= TELL_EVERY_S:
            with self.context.database.write_beside() as session:
                tell_done(session, self.kind.table, self.job.id, done)
            self._told_at = time.monotonic()

    def retry_unavailable(self, ask: Callable[[], _T]) -> _T:
        """What `ask` returns; it is called again while the store is away.

        Raises
        ------
        JobStopped
            Nobody wants the answer any more.
        """
        for pause_s in PAUSES_S:
            try:
                return ask()
            except StorageAway:
                self._pause(pause_s)
        return ask()

    def chunk_done(self, session: Session) -> None:
        """The whole chunk is stored with this transaction; once more is no harm."""
        ChunkRepository(session).mark_done(self.job, self.number)

    def chunk_refused(self, session: Session, why: FilterError) -> None:
        """All of the chunk is stored that can be; the job fails once others are done.

        What is left of it is put into quarantine, as after a process that ended.
        """
        error = {"code": why.kind, "detail": why.detail}
        ChunkRepository(session).refuse(self.job, self.number, error)

    def end_job(self, session: Session) -> None:
        """The job is done with this transaction; JobStopped if it is over already."""
        close(session, self.row(session), "done")

    def stop(self) -> None:
        """Nobody waits for this task any more: its threads are to end."""
        self._is_over.set()

    def _require_open(self) -> None:
        with self.context.database.read() as session:
            if not is_final(self.number):
                self.row(session)
            # A cancellation waits for the final step's transaction before the row.
            elif not ChunkRepository(session).has_final(self.job):
                raise JobStopped(self.job)

    def _pause(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self.check()
            self.context.engine.stopping.wait(min(left, _CHECK_EVERY_S))


AnyTask: TypeAlias = Task[Any]
