"""SQL of jobs: their chunks, and the leases of those who drive them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from datetime import datetime, timedelta
from typing import Any, Final, NamedTuple

from sqlalchemy import ColumnElement, delete, func, select, update
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.bulk import insert_rows, upsert
from app.db.tables import Chunk, Export, Installation, Lease, Run
from app.engine.chunk import Job

DECISION: Final = 0
"""The number of a run's last chunk, which decides all of its boxes; others follow 0."""


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
        number = self._last_number(job)
        rows = [_row(job, number + place, span) for place, span in enumerate(spans, 1)]
        insert_rows(self._session, Chunk, rows)
        return [row["number"] for row in rows]

    def plan_decision(self, job: Job, frames: int) -> None:
        """Add the chunk that decides a run, unless it is there: it may have a past."""
        new = upsert(self._session, Chunk).values(
            _row(job, DECISION, Span(0, 0, frames))
        )
        self._session.execute(new.on_conflict_do_nothing())

    def withdraw_decision(self, job: Job) -> None:
        """Let whoever decides a run notice that somebody is about to cancel it."""
        waiting = Chunk.number == DECISION, Chunk.state == "waiting"
        self._session.execute(delete(Chunk).where(*_chunks_of(job), *waiting))

    def find(self, job: Job, number: int) -> Chunk | None:
        """A chunk, unless its job was forgotten."""
        return self._session.get(Chunk, (job.kind, job.id, number))

    def waiting(self, job: Job) -> list[int]:
        """Numbers of the chunks that an earlier driver has planned and left.

        The decision is none of them: before it there may be new frames to measure.
        """
        rows = select(Chunk.number).where(
            *_chunks_of(job), Chunk.state == "waiting", Chunk.number != DECISION
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

    def finish(self, job: Job, number: int) -> None:
        """A chunk is done; once more is no harm."""
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), Chunk.number == number, Chunk.state == "waiting")
            .values(state="done", error=None, finished_at=utc_now())
        )

    def fail(self, job: Job, number: int, error: Mapping[str, Any]) -> None:
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
            self.give_up(chunk)
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

    def give_up(self, chunk: Chunk) -> None:
        """Put a chunk into quarantine."""
        chunk.state, chunk.finished_at = "quarantined", utc_now()
        self._session.flush()

    def set_aside(self, chunk: Chunk, frame_id: int, left: int) -> None:
        """Put the first frame of what is left of a chunk into quarantine, alone.

        It becomes a chunk of its own; the other one goes on behind it.
        """
        job = Job(chunk.kind, chunk.job_id)
        (number,) = self.plan(job, [Span(frame_id, frame_id, 1)])
        alone = self._session.get_one(Chunk, (*job, number))
        alone.attempts, chunk.attempts = chunk.attempts, 0
        chunk.first_frame_id, chunk.frames = frame_id + 1, left - 1
        self.give_up(alone)

    def begin_again(self, job: Job) -> None:
        """A new driver tries again what an earlier one did not come to report."""
        self._session.execute(
            update(Chunk)
            .where(*_chunks_of(job), Chunk.state == "waiting", Chunk.error.is_not(None))
            .values(error=None)
        )

    def forget(self, job: Job, *, quarantined: bool = True) -> None:
        """Remove the chunks of a job that is over; those in quarantine on request."""
        rows = delete(Chunk).where(*_chunks_of(job))
        if not quarantined:
            rows = rows.where(Chunk.state != "quarantined")
        self._session.execute(rows)

    def forget_dataset(self, dataset_id: int) -> None:
        """Remove what there is about the jobs of a dataset."""
        for kind, table in (("run", Run), ("export", Export)):
            jobs = select(table.id).where(table.dataset_id == dataset_id)
            for rows in (Chunk, Lease):
                mine = rows.kind == kind, rows.job_id.in_(jobs)
                self._session.execute(delete(rows).where(*mine))

    def _last_number(self, job: Job) -> int:
        rows = select(func.max(Chunk.number)).where(*_chunks_of(job))
        return self._session.scalar(rows) or 0


def _row(job: Job, number: int, span: Span) -> dict[str, Any]:
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


LASTS: Final = timedelta(seconds=8)
"""For how long a process that says nothing more is taken to be alive."""


class LeaseRepository:
    """Rows of `leases`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def now(self) -> datetime:
        """The time that all who share the database agree on."""
        if self._session.connection().dialect.name != "postgresql":
            return utc_now()
        return self._session.scalar(select(func.clock_timestamp())) or utc_now()

    def take(self, job: Job, holder: str, is_void: Callable[[str], bool]) -> bool:
        """Make this process the one that drives a job; False if another one does.

        A lease that has run out, or whose holder `is_void`, is nobody's.
        """
        now = self.now()
        # Whoever is storing the job's end holds its row: not to be waited for.
        rows = select(Lease).where(*_lease_of(job)).with_for_update(skip_locked=True)
        lease = self._session.scalar(rows)
        if lease is None:
            row = {"kind": job.kind, "job_id": job.id, "holder": holder}
            new = upsert(self._session, Lease).values(**row, until=now + LASTS)
            added = new.on_conflict_do_nothing().returning(Lease.holder)
            return self._session.execute(added).first() is not None
        taken = lease.holder != holder and lease.until > now
        if taken and not is_void(lease.holder):
            return False
        lease.holder, lease.until = holder, now + LASTS
        self._session.flush()
        return True

    def renew(self, job: Job, holder: str) -> bool:
        """Say that the holder is alive; False if the lease is not its own any more."""
        rows = select(Lease.holder).where(*_lease_of(job)).with_for_update()
        if self._session.scalar(rows) != holder:
            return False
        until = self.now() + LASTS
        self._session.execute(update(Lease).where(*_lease_of(job)).values(until=until))
        return True

    def is_held(self, job: Job, holder: str) -> bool:
        """Whether nobody else has taken the job; nobody can until the commit."""
        rows = select(Lease.holder).where(*_lease_of(job)).with_for_update()
        return self._session.scalar(rows) == holder

    def end(self, job: Job, holder: str) -> None:
        """Give a lease back that is one's own."""
        mine = delete(Lease).where(*_lease_of(job), Lease.holder == holder)
        self._session.execute(mine)

    def clear(self, job: Job, is_void: Callable[[str], bool]) -> None:
        """Remove a lease that is nobody's any more; its job is over."""
        rows = select(Lease).where(*_lease_of(job)).with_for_update(skip_locked=True)
        lease = self._session.scalar(rows)
        if lease is not None and (lease.until <= self.now() or is_void(lease.holder)):
            self._session.delete(lease)
            self._session.flush()

    def live(self, is_void: Callable[[str], bool]) -> tuple[set[Job], set[Job]]:
        """Jobs that somebody drives, and jobs whose lease is nobody's any more."""
        now, driven, void = self.now(), set[Job](), set[Job]()
        for lease in self._session.scalars(select(Lease)):
            gone = lease.until <= now or is_void(lease.holder)
            (void if gone else driven).add(Job(lease.kind, lease.job_id))
        return driven, void

    def installation(self) -> str:
        """What tells this database from every other one."""
        return self._session.scalar(select(Installation.id).limit(1)) or ""


def _lease_of(job: Job) -> list[ColumnElement[bool]]:
    return [Lease.kind == job.kind, Lease.job_id == job.id]
