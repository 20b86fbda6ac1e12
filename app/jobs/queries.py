"""SQL of jobs: the columns that all kinds share, their chunks and their leases.

A job is a row of its kind's table (`JobRow`). It is queued, then running, and finally
done, failed or cancelled; only `close` sets a final state.
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
"""The number of a job's final step in `chunks`; other chunks have higher numbers."""

Row = TypeVar("Row", bound=JobRow)


def job_of(row: JobRow) -> Job:
    """The identity of a row's job in engines, chunks and leases."""
    return Job(row.job_kind, row.id)


def find_job(session: Session, table: type[Row], job_id: int) -> Row | None:
    """A job's row, unless it was deleted with its dataset."""
    found = session.get(table, job_id)
    if found is None or is_deleted(session, found.dataset_id):
        return None
    return found


def open_job(session: Session, table: type[Row], job_id: int) -> Row:
    """The row of a job that is queued or running.

    Raises
    ------
    JobStopped
        The job has ended, or its dataset was deleted.
    """
    found = find_job(session, table, job_id)
    if found is None or found.state not in OPEN:
        raise JobStopped(Job(table.job_kind, job_id))
    return found


def open_jobs(
    session: Session, table: type[JobRow], dataset_id: int | None = None
) -> list[Job]:
    """Jobs that are queued or running, oldest first: all, or those of a dataset."""
    rows = select(table.id).where(table.state.in_(OPEN)).order_by(table.id)
    if dataset_id is not None:
        rows = rows.where(table.dataset_id == dataset_id)
    return [Job(table.job_kind, id_) for id_ in session.scalars(rows)]


def count_open(session: Session, table: type[JobRow], author: str | None = None) -> int:
    """How many jobs of a kind are queued or running: all, or those of one token."""
    rows = select(func.count(table.id)).where(table.state.in_(OPEN))
    if author is not None:
        rows = rows.where(table.created_by == author)
    return session.scalar(rows) or 0


def tell_done(session: Session, row: type[JobRow], job_id: int, done: int) -> None:
    """Store the progress of a running job, unless a higher one is stored."""
    further = row.id == job_id, row.state == "running", row.done < done
    session.execute(update(row).where(*further).values(done=done))


def close(
    session: Session,
    row: JobRow,
    state: FinishedState,
    error: Mapping[str, object] | None = None,
) -> None:
    """Set the final state of a job.

    Its chunks are removed, except the quarantined ones of a failed job, which show why
    it failed.

    Raises
    ------
    JobStopped
        It has ended already.
    """
    if row.state not in OPEN:
        raise JobStopped(job_of(row))
    row.state, row.finished_at = state, utc_now()
    if error is not None:
        row.error = dict(error)
    session.flush()
    ChunkRepository(session).forget(job_of(row), keep_quarantined=state == "failed")


class Span(NamedTuple):
    """The frames of a chunk: their first and last id, and their number."""

    first_frame_id: int
    last_frame_id: int
    frames: int


class ChunkRepository:
    """Rows of `chunks`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def plan(self, job: Job, spans: Iterable[Span]) -> list[int]:
        """Add chunks to a job; returns their numbers."""
        numbered = dict(enumerate(spans, self._last_number(job) + 1))
        rows = [_row(job, number, span) for number, span in numbered.items()]
        insert_rows(self._session, Chunk, rows)
        return list(numbered)

    def plan_final(self, job: Job, frames: int) -> int:
        """Add a job's final step, unless it exists; returns its number."""
        new = upsert(self._session, Chunk).values(_row(job, FINAL, Span(0, 0, frames)))
        self._session.execute(new.on_conflict_do_nothing())
        return FINAL

    def withdraw_final(self, job: Job) -> None:
        """Delete a job's final step, by which its process notices a cancellation."""
        waiting = Chunk.number == FINAL, Chunk.state == "waiting"
        self._session.execute(delete(Chunk).where(*_chunks_of(job), *waiting))

    def has_final(self, job: Job) -> bool:
        """Whether the final step is planned, and was not withdrawn."""
        return self.find(job, FINAL) is not None

    def find(self, job: Job, number: int) -> Chunk | None:
        """A chunk, unless its job has been removed."""
        return self._session.get(Chunk, (job.kind, job.id, number))

    def waiting(self, job: Job) -> list[int]:
        """Numbers of the chunks that an earlier driver has planned and not finished.

        The final step is left out: there may be new frames to process before it.
        """
        rows = select(Chunk.number).where(
            *_chunks_of(job), Chunk.state == "waiting", Chunk.number != FINAL
        )
        return list(self._session.scalars(rows.order_by(Chunk.number)))

    def quarantined(self, job: Job) -> list[Chunk]:
        """Chunks that are not retried any more."""
        rows = select(Chunk).where(*_chunks_of(job), Chunk.state == "quarantined")
        return list(self._session.scalars(rows.order_by(Chunk.number)))

    def last_frame(self, job: Job) -> int:
        """The last frame id up to which a job is planned."""
        rows = select(func.max(Chunk.last_frame_id)).where(*_chunks_of(job))
        return self._session.scalar(rows) or 0

    def has_chunks(self, job: Job) -> bool:
        """Whether a job has chunks."""
        return self._last_number(job) > 0

    def mark_done(self, job: Job, number: int) -> None:
        """Mark a chunk as done; idempotent."""
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), Chunk.number == number, Chunk.state == "waiting")
            .values(state="done", error=None, finished_at=utc_now())
        )

    def refuse(self, job: Job, number: int, error: Mapping[str, object]) -> None:
        """Quarantine a chunk that cannot be processed, with the error."""
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), Chunk.number == number, Chunk.state == "waiting")
            .values(state="quarantined", error=dict(error), finished_at=utc_now())
        )

    def fail(self, job: Job, number: int, error: Mapping[str, object]) -> None:
        """Store the error with which the job has to fail."""
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), Chunk.number == number)
            .values(error=dict(error))
        )

    def suspect(self, job: Job, number: int, most_attempts: int) -> bool:
        """Count the death of a process during a chunk; True if it is to be retried.

        After `most_attempts` the chunk is quarantined.
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
        """Count an attempt before a process begins, since its death is not reported."""
        chunk.attempts += 1
        self._session.flush()

    def forget_attempts(self, job: Job, number: int) -> None:
        """Reset the attempts: the process that works on the chunk is alive."""
        waiting = Chunk.number == number, Chunk.state == "waiting"
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), *waiting, Chunk.attempts > 0)
            .values(attempts=0)
        )

    def quarantine(self, chunk: Chunk) -> None:
        """Mark a chunk as not to be retried."""
        chunk.state, chunk.finished_at = "quarantined", utc_now()
        self._session.flush()

    def quarantine_frame(self, chunk: Chunk, frame_id: int, unfinished: int) -> None:
        """Quarantine one frame of a chunk, so that the others can be retried.

        The frame is the first of `unfinished` frames that have no result yet. It
        becomes a chunk of its own, and the chunk begins after it.
        """
        job = Job(chunk.kind, chunk.job_id)
        (number,) = self.plan(job, [Span(frame_id, frame_id, 1)])
        alone = self._session.get_one(Chunk, (*job, number))
        alone.attempts, chunk.attempts = chunk.attempts, 0
        chunk.first_frame_id, chunk.frames = frame_id + 1, unfinished - 1
        self.quarantine(alone)

    def clear_errors(self, job: Job) -> None:
        """Clear errors of waiting chunks, which an earlier driver has not reported."""
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), Chunk.state == "waiting", Chunk.error.is_not(None))
            .values(error=None)
        )

    def forget(self, job: Job, *, keep_quarantined: bool) -> None:
        """Delete the chunks of a job that has ended."""
        rows = delete(Chunk).where(*_chunks_of(job))
        if keep_quarantined:
            rows = rows.where(Chunk.state != "quarantined")
        self._session.execute(rows)

    def forget_dataset(self, table: type[JobRow], dataset_id: int) -> None:
        """Delete the chunks and leases of a dataset's jobs of one kind."""
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
"""How long a lease is valid after it was taken or renewed."""


class LeasedJobs(NamedTuple):
    """Jobs that have a lease.

    Attributes
    ----------
    driven : set of Job
        Their lease is valid: a process drives them.
    void : set of Job
        Their lease has expired, or the process that holds it has ended.
    """

    driven: set[Job]
    void: set[Job]


class LeaseRepository:
    """Rows of `leases`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def now(self) -> datetime:
        """The current time, by a clock that all processes of the database share."""
        if self._session.connection().dialect.name != "postgresql":
            return utc_now()
        return self._session.scalar(select(func.clock_timestamp())) or utc_now()

    def take(self, job: Job, holder: str, has_ended: Callable[[str], bool]) -> bool:
        """Make `holder` the process that drives a job; False if another one does.

        A lease can be taken over once it has expired, or if `has_ended` is true for the
        process that holds it.
        """
        now = self.now()
        # A process that is ending the job has locked this row: do not wait for it.
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
        """Renew the holder's lease; False if another process has taken it."""
        rows = select(Lease.holder).where(*_lease_of(job)).with_for_update()
        if self._session.scalar(rows) != holder:
            return False
        until = self.now() + LEASE_LASTS
        self._session.execute(update(Lease).where(*_lease_of(job)).values(until=until))
        return True

    def is_held(self, job: Job, holder: str) -> bool:
        """Whether the holder has the lease; locks it until this transaction ends."""
        rows = select(Lease.holder).where(*_lease_of(job)).with_for_update()
        return self._session.scalar(rows) == holder

    def leave(self, job: Job, holder: str) -> None:
        """Let the holder's lease expire now, so that any process may take the job.

        The row stays. Without it, a watchdog would treat the job as new, and wait for
        the service that queued it.
        """
        mine = update(Lease).where(*_lease_of(job), Lease.holder == holder)
        # Without a holder, so that a concurrent renewal does not prolong it.
        self._session.execute(mine.values(holder="", until=self.now()))

    def end(self, job: Job, holder: str) -> None:
        """Delete the holder's lease of a job that has ended."""
        mine = delete(Lease).where(*_lease_of(job), Lease.holder == holder)
        self._session.execute(mine)

    def clear(self, job: Job, has_ended: Callable[[str], bool]) -> None:
        """Delete the lease of a finished job if its holder has ended, too."""
        rows = select(Lease).where(*_lease_of(job)).with_for_update(skip_locked=True)
        lease = self._session.scalar(rows)
        if lease is not None and (lease.until <= self.now() or has_ended(lease.holder)):
            self._session.delete(lease)
            self._session.flush()

    def leased_jobs(self, has_ended: Callable[[str], bool]) -> LeasedJobs:
        """All jobs that have a lease, separated by whether it is valid."""
        now, jobs = self.now(), LeasedJobs(set(), set())
        for lease in self._session.scalars(select(Lease)):
            is_void = lease.until <= now or has_ended(lease.holder)
            (jobs.void if is_void else jobs.driven).add(Job(lease.kind, lease.job_id))
        return jobs

    def installation(self) -> str:
        """The unique id of this database."""
        return self._session.scalar(select(Installation.id).limit(1)) or ""


def _lease_of(job: Job) -> list[ColumnElement[bool]]:
    return [Lease.kind == job.kind, Lease.job_id == job.id]
