"""SQL of jobs: what all their rows have in common, their chunks, and who drives them.

A job is a row of its kind's table (`JobRow`): queued, running, and at last done, failed
or cancelled. `close` is the only way to an end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from datetime import datetime, timedelta
from typing import Final, NamedTuple, TypeVar

from sqlalchemy import ColumnElement, delete, func, select, update
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.bulk import insert_rows, upsert
from app.db.tables import Chunk, Installation, JobRow, Lease
from app.engine.chunk import Job, JobStopped
from app.measuring.queries import is_deleted
from unghost.wire.words import FinishedState

OPEN: Final = ("queued", "running")
FINAL: Final = 0
"""The number of a job's final step in `chunks`; those of its other chunks follow."""

Row = TypeVar("Row", bound=JobRow)


def job_of(row: JobRow) -> Job:
    """The name by which engines, chunks and leases know the job of a row."""
    return Job(row.job_kind, row.id)


def find_job(session: Session, table: type[Row], job_id: int) -> Row | None:
    """A job's row, unless it was deleted with its dataset."""
    found = session.get(table, job_id)
    if found is None or is_deleted(session, found.dataset_id):
        return None
    return found


def open_job(session: Session, table: type[Row], job_id: int) -> Row:
    """The row of a job that is to go on.

    Raises
    ------
    JobStopped
        The job is over, or its dataset was deleted.
    """
    found = find_job(session, table, job_id)
    if found is None or found.state not in OPEN:
        raise JobStopped(Job(table.job_kind, job_id))
    return found


def open_jobs(
    session: Session, table: type[JobRow], dataset_id: int | None = None
) -> list[Job]:
    """Jobs that are queued or were begun, oldest first: all, or those of a dataset."""
    rows = select(table.id).where(table.state.in_(OPEN)).order_by(table.id)
    if dataset_id is not None:
        rows = rows.where(table.dataset_id == dataset_id)
    return [Job(table.job_kind, id_) for id_ in session.scalars(rows)]


def count_open(session: Session, table: type[JobRow], author: str | None = None) -> int:
    """How many jobs of a kind wait or work: all, or those of one token."""
    rows = select(func.count(table.id)).where(table.state.in_(OPEN))
    if author is not None:
        rows = rows.where(table.created_by == author)
    return session.scalar(rows) or 0


def tell_done(session: Session, row: type[JobRow], job_id: int, done: int) -> None:
    """Note how far a job is, unless it is further or over."""
    further = row.id == job_id, row.state == "running", row.done < done
    session.execute(update(row).where(*further).values(done=done))


def close(
    session: Session,
    row: JobRow,
    state: FinishedState,
    error: Mapping[str, object] | None = None,
) -> None:
    """End a job; this is final.

    Its chunks are removed. Of a job that failed, those in quarantine stay, so that it
    can be found out why it failed.

    Raises
    ------
    JobStopped
        It is over already.
    """
    if row.state not in OPEN:
        raise JobStopped(job_of(row))
    row.state, row.finished_at = state, utc_now()
    if error is not None:
        row.error = dict(error)
    session.flush()
    ChunkRepository(session).forget(job_of(row), keep_quarantined=state == "failed")


class Span(NamedTuple):
    """Frames that are worked on together: the first id, the last, and how many."""

    first_frame_id: int
    last_frame_id: int
    frames: int


class ChunkRepository:
    """Rows of `chunks`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def plan(self, job: Job, spans: Iterable[Span]) -> list[int]:
        """Add chunks to a job; their numbers."""
        numbered = dict(enumerate(spans, self._last_number(job) + 1))
        rows = [_row(job, number, span) for number, span in numbered.items()]
        insert_rows(self._session, Chunk, rows)
        return list(numbered)

    def plan_final(self, job: Job, frames: int) -> int:
        """Add a job's final step unless it is there, with its attempts; its number."""
        new = upsert(self._session, Chunk).values(_row(job, FINAL, Span(0, 0, frames)))
        self._session.execute(new.on_conflict_do_nothing())
        return FINAL

    def withdraw_final(self, job: Job) -> None:
        """Let the process in a job's final step notice that it is being cancelled."""
        waiting = Chunk.number == FINAL, Chunk.state == "waiting"
        self._session.execute(delete(Chunk).where(*_chunks_of(job), *waiting))

    def has_final(self, job: Job) -> bool:
        """Whether the final step is planned, and was not withdrawn."""
        return self.find(job, FINAL) is not None

    def find(self, job: Job, number: int) -> Chunk | None:
        """A chunk, unless its job was forgotten."""
        return self._session.get(Chunk, (job.kind, job.id, number))

    def waiting(self, job: Job) -> list[int]:
        """Numbers of the chunks that an earlier driver has planned and left.

        The final step is none of them: before it there may be new frames to work on.
        """
        rows = select(Chunk.number).where(
            *_chunks_of(job), Chunk.state == "waiting", Chunk.number != FINAL
        )
        return list(self._session.scalars(rows.order_by(Chunk.number)))

    def quarantined(self, job: Job) -> list[Chunk]:
        """Chunks that nobody will try again."""
        rows = select(Chunk).where(*_chunks_of(job), Chunk.state == "quarantined")
        return list(self._session.scalars(rows.order_by(Chunk.number)))

    def last_frame(self, job: Job) -> int:
        """Up to where a job is planned."""
        rows = select(func.max(Chunk.last_frame_id)).where(*_chunks_of(job))
        return self._session.scalar(rows) or 0

    def is_planned(self, job: Job) -> bool:
        """Whether a job has chunks."""
        return self._last_number(job) > 0

    def mark_done(self, job: Job, number: int) -> None:
        """A chunk is done; once more is no harm."""
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), Chunk.number == number, Chunk.state == "waiting")
            .values(state="done", error=None, finished_at=utc_now())
        )

    def refuse(self, job: Job, number: int, error: Mapping[str, object]) -> None:
        """Put a chunk into quarantine that a living process cannot do, and say why."""
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), Chunk.number == number, Chunk.state == "waiting")
            .values(state="quarantined", error=dict(error), finished_at=utc_now())
        )

    def fail(self, job: Job, number: int, error: Mapping[str, object]) -> None:
        """Note what its job is to fail with."""
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), Chunk.number == number)
            .values(error=dict(error))
        )

    def suspect(self, job: Job, number: int, most_attempts: int) -> bool:
        """A process ended while it worked on a chunk; True if it is to be tried again.

        After so many attempts it is put into quarantine.
        """
        chunk = self.find(job, number)
        if chunk is None or chunk.state != "waiting":
            return False
        chunk.attempts += 1
        if chunk.attempts >= most_attempts:
            self.quarantine(chunk)
        self._session.flush()
        return chunk.state == "waiting"

    def attempt(self, chunk: Chunk) -> None:
        """A process begins to work on a chunk, and nobody will be told if it ends."""
        chunk.attempts += 1
        self._session.flush()

    def forget_attempts(self, job: Job, number: int) -> None:
        """The process that works on a chunk lives, and so it is not to blame."""
        waiting = Chunk.number == number, Chunk.state == "waiting"
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), *waiting, Chunk.attempts > 0)
            .values(attempts=0)
        )

    def quarantine(self, chunk: Chunk) -> None:
        """Mark a chunk as one that nobody tries again."""
        chunk.state, chunk.finished_at = "quarantined", utc_now()
        self._session.flush()

    def quarantine_frame(self, chunk: Chunk, frame_id: int, unfinished: int) -> None:
        """Put one frame of a chunk into quarantine, and let the others be tried again.

        The frame is the first of `unfinished` frames that have no result yet. It
        becomes a chunk of its own, and the chunk begins behind it.
        """
        job = Job(chunk.kind, chunk.job_id)
        (number,) = self.plan(job, [Span(frame_id, frame_id, 1)])
        alone = self._session.get_one(Chunk, (*job, number))
        alone.attempts, chunk.attempts = chunk.attempts, 0
        chunk.first_frame_id, chunk.frames = frame_id + 1, unfinished - 1
        self.quarantine(alone)

    def clear_errors(self, job: Job) -> None:
        """Forget errors of waiting chunks, which an earlier driver has not reported."""
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), Chunk.state == "waiting", Chunk.error.is_not(None))
            .values(error=None)
        )

    def forget(self, job: Job, *, keep_quarantined: bool) -> None:
        """Remove the chunks of a job that is over."""
        rows = delete(Chunk).where(*_chunks_of(job))
        if keep_quarantined:
            rows = rows.where(Chunk.state != "quarantined")
        self._session.execute(rows)

    def forget_dataset(self, table: type[JobRow], dataset_id: int) -> None:
        """Remove chunks and leases of all jobs of one kind of a dataset."""
        jobs = select(table.id).where(table.dataset_id == dataset_id)
        for rows in (Chunk, Lease):
            mine = rows.kind == table.job_kind, rows.job_id.in_(jobs)
            self._session.execute(delete(rows).where(*mine))

    def _last_number(self, job: Job) -> int:
        rows = select(func.max(Chunk.number)).where(*_chunks_of(job))
        return self._session.scalar(rows) or 0


def is_final(number: int) -> bool:
    """Whether the chunk of this number is its job's final step."""
    return number == FINAL


def _row(job: Job, number: int, span: Span) -> dict[str, object]:
    return {
        "kind": job.kind,
        "job_id": job.id,
        "number": number,
        **span._asdict(),
        "state": "waiting",
        "attempts": 0,
        "error": None,
        "finished_at": None,
    }


def _chunks_of(job: Job) -> list[ColumnElement[bool]]:
    return [Chunk.kind == job.kind, Chunk.job_id == job.id]


LEASE_LASTS: Final = timedelta(seconds=8)
"""How long a lease holds after it was taken or renewed."""


class LeasedJobs(NamedTuple):
    """Jobs that have a lease.

    Attributes
    ----------
    driven : set of Job
        Their lease holds: a process drives them.
    void : set of Job
        Their lease has run out, or the process that holds it has ended.
    """

    driven: set[Job]
    void: set[Job]


class LeaseRepository:
    """Rows of `leases`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def now(self) -> datetime:
        """The time that all who share the database agree on."""
        if self._session.connection().dialect.name != "postgresql":
            return utc_now()
        return self._session.scalar(select(func.clock_timestamp())) or utc_now()

    def take(self, job: Job, holder: str, has_ended: Callable[[str], bool]) -> bool:
        """Make `holder` the process that drives a job; False if another one does.

        A lease can be taken over once it has run out, or if `has_ended` says that the
        process which holds it has ended.
        """
        now = self.now()
        # A process that is storing the job's end holds its row: do not wait for it.
        rows = select(Lease).where(*_lease_of(job)).with_for_update(skip_locked=True)
        lease = self._session.scalar(rows)
        if lease is None:
            row = {"kind": job.kind, "job_id": job.id, "holder": holder}
            new = upsert(self._session, Lease).values(**row, until=now + LEASE_LASTS)
            added = new.on_conflict_do_nothing().returning(Lease.holder)
            return self._session.execute(added).first() is not None
        is_anothers = lease.holder != holder and lease.until > now
        if is_anothers and not has_ended(lease.holder):
            return False
        lease.holder, lease.until = holder, now + LEASE_LASTS
        self._session.flush()
        return True

    def renew(self, job: Job, holder: str) -> bool:
        """Say that the holder is alive; False if the lease is not its own any more."""
        rows = select(Lease.holder).where(*_lease_of(job)).with_for_update()
        if self._session.scalar(rows) != holder:
            return False
        until = self.now() + LEASE_LASTS
        self._session.execute(update(Lease).where(*_lease_of(job)).values(until=until))
        return True

    def is_held(self, job: Job, holder: str) -> bool:
        """Whether the holder drives the job; then nobody else can until the commit."""
        rows = select(Lease.holder).where(*_lease_of(job)).with_for_update()
        return self._session.scalar(rows) == holder

    def leave(self, job: Job, holder: str) -> None:
        """Let one's own lease run out now, so that any process may take the job.

        The row stays. Without it, a watchdog would take the job for a new one, and wait
        for the service that was asked for it.
        """
        mine = update(Lease).where(*_lease_of(job), Lease.holder == holder)
        # Without a holder, so that no renewal on its way makes it last again.
        self._session.execute(mine.values(holder="", until=self.now()))

    def end(self, job: Job, holder: str) -> None:
        """Remove a lease that is one's own; its job is over."""
        mine = delete(Lease).where(*_lease_of(job), Lease.holder == holder)
        self._session.execute(mine)

    def clear(self, job: Job, has_ended: Callable[[str], bool]) -> None:
        """Remove the lease of a job that is over, unless a living process holds it."""
        rows = select(Lease).where(*_lease_of(job)).with_for_update(skip_locked=True)
        lease = self._session.scalar(rows)
        if lease is not None and (lease.until <= self.now() or has_ended(lease.holder)):
            self._session.delete(lease)
            self._session.flush()

    def leased_jobs(self, has_ended: Callable[[str], bool]) -> LeasedJobs:
        """All jobs that have a lease, told apart by whether it still holds."""
        now, jobs = self.now(), LeasedJobs(set(), set())
        for lease in self._session.scalars(select(Lease)):
            is_void = lease.until <= now or has_ended(lease.holder)
            (jobs.void if is_void else jobs.driven).add(Job(lease.kind, lease.job_id))
        return jobs

    def installation(self) -> str:
        """What tells this database from every other one."""
        return self._session.scalar(select(Installation.id).limit(1)) or ""


def _lease_of(job: Job) -> list[ColumnElement[bool]]:
    return [Lease.kind == job.kind, Lease.job_id == job.id]
