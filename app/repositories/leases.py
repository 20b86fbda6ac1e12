"""Leases: which process drives a job; by the database's clock where it has one."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Final

from sqlalchemy import ColumnElement, delete, func, select, update
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.bulk import upsert
from app.db.tables import Installation, Lease
from app.engine.chunk import Job

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
        rows = select(Lease).where(*_of(job)).with_for_update(skip_locked=True)
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
        rows = select(Lease.holder).where(*_of(job)).with_for_update()
        if self._session.scalar(rows) != holder:
            return False
        until = self.now() + LASTS
        self._session.execute(update(Lease).where(*_of(job)).values(until=until))
        return True

    def is_held(self, job: Job, holder: str) -> bool:
        """Whether nobody else has taken the job; nobody can until the commit."""
        rows = select(Lease.holder).where(*_of(job)).with_for_update()
        return self._session.scalar(rows) == holder

    def end(self, job: Job, holder: str) -> None:
        """Give a lease back that is one's own."""
        mine = delete(Lease).where(*_of(job), Lease.holder == holder)
        self._session.execute(mine)

    def clear(self, job: Job, is_void: Callable[[str], bool]) -> None:
        """Remove a lease that is nobody's any more; its job is over."""
        rows = select(Lease).where(*_of(job)).with_for_update(skip_locked=True)
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


def _of(job: Job) -> list[ColumnElement[bool]]:
    return [Lease.kind == job.kind, Lease.job_id == job.id]
