"""Who drives a job: its lease, and the watchdog that takes over if its process dies.

The *driver* of a job is the process that plans its chunks and has them executed
(`app.jobs.driver`). It has the job's lease, a row that says which process that is and
until when. It takes the lease in the transaction that begins the job, and renews it
until the job ends.

Every service runs a watchdog. It lets its own process drive each open job (one that is
queued or running) whose driver is gone:

- **The job has a lease that is void**: somebody has begun it. A lease is void if it has
  expired, or if the driver ran on this machine and the operating system says that it
  has ended (`process_has_ended`). It expires if the driver does not renew it for
  `LEASE_LASTS`, and at once if the driver stops and leaves the job (`release`).
- **The job has had no lease** for `UNDRIVEN_FOR_S`: nobody has begun it. The service
  that queued it has died, or is still busy with other jobs.

The new driver continues with what the database says (`JobDriver`).

**A driver that is only slow** may lose its lease and not know. It notices when it next
renews the lease. It also notices before it plans chunks, counts the death of a worker,
begins the final step or lets the job fail: all of these require the lease.

Storing results does not require it, so that a worker needs none. Instead, each
transaction that stores results looks which of them are there already
(`EvidenceRepository.lacking`), and ending a job requires that it is open (`close`). So
if two processes work on the same chunk, no result is stored or counted twice, and the
second one to reach the end finds that the job has ended.
"""

from __future__ import annotations

import logging
import os
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final, NamedTuple

from sqlalchemy import func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.background import Task, repeating
from app.context import ServiceContext
from app.db.base import utc_now
from app.db.bulk import insert_into
from app.db.engine import Database, once_committed
from app.db.tables import Lease
from app.engine.chunk import Job, JobStopped
from app.jobs.kind import all_open_jobs, is_open

LEASE_LASTS: Final = timedelta(seconds=8)
"""How long a lease is valid after it was taken or renewed."""
RENEW_EVERY_S: Final = 2.0
WATCHDOG_EVERY_S: Final = 2.0
"""How often the watchdog looks for jobs that this process should drive."""
UNDRIVEN_FOR_S: Final = 10.0
"""Seconds that an open job may be without a lease before any service drives it.

The service that queued the job has this time to begin it.
"""

log = logging.getLogger(__name__)


class LeaseLost(JobStopped):
    """Another process drives the job: this one must not write to it any more."""


class JobLease:
    """The lease of one job, for the process `holder`.

    What becomes of the row depends on how the driver ends:

    - The job has ended: `release` deletes the row.
    - The driver leaves an open job (a stop, a lost connection): `release` lets the
      lease expire at once, so that any process can take it.
    - The driver dies: the lease becomes void. The watchdog of another process takes it,
      or deletes it if the job has ended.
    - The dataset is deleted: `end_all` of `app.jobs.service` deletes the row.
    """

    def __init__(self, database: Database, job: Job, holder: str) -> None:
        self.job = job
        self._database, self._holder = database, holder
        self._is_taken = self._is_lost = False
        self._is_over = threading.Event()

    def take(self, session: Session) -> None:
        """Take the lease, also one that is void, or `require` it if this has taken it.

        Once that is committed, a thread renews it. Raises LeaseLost if another process
        drives the job.
        """
        if self._is_taken:
            self.require(session)
            return
        now = _now(session)
        row = {"kind": self.job.kind, "job_id": self.job.id, "holder": self._holder}
        new = insert_into(session, Lease).values(**row, until=now + LEASE_LASTS)
        added = new.on_conflict_do_nothing().returning(Lease.holder)
        if session.execute(added).first() is None:  # there is a row already
            lease = _locked(session, self.job, skip_locked=True)
            if lease is None:  # another process has just locked or deleted it
                raise LeaseLost(self.job)
            if lease.holder != self._holder and not _is_void(lease, now):
                raise LeaseLost(self.job)
            lease.holder, lease.until = self._holder, now + LEASE_LASTS
            session.flush()
        once_committed(session, self._start_renewing)

    def require(self, session: Session) -> None:
        """Lock the lease until this transaction ends, so that no other can take it.

        Raises LeaseLost if another process has taken it already.
        """
        if self._own(session) is None:
            raise LeaseLost(self.job)

    def check(self) -> None:
        """Raise `LeaseLost` if the last renewal found that another process has it."""
        if self._is_lost:
            raise LeaseLost(self.job)

    def release(self) -> None:
        """Give up the lease: this process no longer drives the job.

        If the job has not ended, the watchdog of any process can take it over.
        """
        self._is_over.set()
        if not self._is_taken or self._is_lost:
            return
        try:
            # Out of turn: without waiting for those who write to other rows.
            with self._database.write_out_of_turn() as session:
                lease = self._own(session)
                if lease is None:
                    return
                if is_open(session, self.job):
                    # Not deleted: without a lease, the watchdog would wait for
                    # `UNDRIVEN_FOR_S`. The holder is emptied so that a renewal that has
                    # begun already does not prolong the lease.
                    lease.holder, lease.until = "", _now(session)
                else:
                    session.delete(lease)
        except SQLAlchemyError as exc:  # the lease expires by itself
            log.warning("cannot release the lease of %s %d: %s", *self.job, exc)

    def _own(self, session: Session) -> Lease | None:
        lease = _locked(session, self.job)
        return lease if lease is not None and lease.holder == self._holder else None

    def _start_renewing(self) -> None:
        if not self._is_taken:
            self._is_taken = True
            threading.Thread(target=self._renew, name="lease", daemon=True).start()

    def _renew(self) -> None:
        while not self._is_over.wait(RENEW_EVERY_S):
            try:
                with self._database.write_out_of_turn() as session:
                    lease = self._own(session)
                    if lease is not None:
                        lease.until = _now(session) + LEASE_LASTS
            except SQLAlchemyError as exc:  # retried until the lease expires
                log.warning("cannot renew the lease of %s %d: %s", *self.job, exc)
                continue
            if lease is None and not self._is_over.is_set():
                log.warning("%s %d is driven by another process now", *self.job)
                self._is_lost = True
                return


class Leases:
    """The leases of this process; only one thread at a time drives a job."""

    def __init__(self) -> None:
        self.holder = this_process()
        self._driven: set[Job] = set()
        self._free = threading.Condition()

    @property
    def driven(self) -> frozenset[Job]:
        """Jobs that a thread of this process drives, with or without the lease."""
        with self._free:
            return frozenset(self._driven)

    @contextmanager
    def driving(self, database: Database, job: Job) -> Iterator[JobLease]:
        """The lease of a job, not taken yet; released when the block ends.

        Waits while another thread of this process drives the same job.
        """
        with self._free:
            self._free.wait_for(lambda: job not in self._driven)
            self._driven.add(job)
        lease = JobLease(database, job, self.holder)
        try:
            yield lease
        finally:
            lease.release()
            with self._free:
                self._driven.discard(job)
                self._free.notify_all()


class Leased(NamedTuple):
    """Jobs that have a lease, separated by whether it is valid or void."""

    valid: set[Job]
    void: set[Job]

    @classmethod
    def of(cls, session: Session) -> Leased:
        """All jobs that have a lease."""
        now, leased = _now(session), cls(set(), set())
        for lease in session.scalars(select(Lease)):
            jobs = leased.void if _is_void(lease, now) else leased.valid
            jobs.add(Job(lease.kind, lease.job_id))
        return leased


def _is_void(lease: Lease, now: datetime) -> bool:
    return lease.until <= now or process_has_ended(lease.holder)


def _now(session: Session) -> datetime:
    """The current time, by a clock that all processes of the database share."""
    if session.connection().dialect.name != "postgresql":
        return utc_now()
    return session.scalar(select(func.clock_timestamp())) or utc_now()


def _locked(session: Session, job: Job, *, skip_locked: bool = False) -> Lease | None:
    """The row of a job's lease, locked; with `skip_locked` None if another has it."""
    rows = select(Lease).where(Lease.kind == job.kind, Lease.job_id == job.id)
    return session.scalar(rows.with_for_update(skip_locked=skip_locked))


class Watchdog:
    """Finds the jobs that this process should drive, since nobody else does.

    It uses its own clock, because the clock of the service that queued a job may be
    wrong.
    """

    def __init__(
        self, context: ServiceContext, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._context, self._clock = context, clock
        # Open jobs without a lease, and when this was first seen.
        self._undriven_since: dict[Job, float] = {}

    def abandoned(self) -> list[Job]:
        """The open jobs whose lease is void, or that have had none for too long.

        Void leases of jobs that have ended are deleted.
        """
        with self._context.database.read() as session:
            unfinished = all_open_jobs(session)
            leased = Leased.of(session)
        if of_ended_jobs := leased.void.difference(unfinished):
            with self._context.database.write_out_of_turn() as session:
                for job in of_ended_jobs:
                    lease = _locked(session, job, skip_locked=True)
                    if lease is not None and _is_void(lease, _now(session)):
                        session.delete(lease)
                        session.flush()
        now, before = self._clock(), self._undriven_since
        undriven = [job for job in unfinished if job not in leased.valid | leased.void]
        since = {job: before.get(job, now) for job in undriven}
        self._undriven_since = since
        due = leased.void.union(
            job for job in undriven if now - since[job] >= UNDRIVEN_FOR_S
        )
        return [job for job in unfinished if job in due]


@contextmanager
def running_watchdog(
    context: ServiceContext, start: Callable[[Iterable[Job]], None]
) -> Iterator[None]:
    """Start open jobs now, and look for abandoned ones until the block ends.

    `start` lets this process drive jobs. Those that another process drives may be
    among them: `JobLease.take` refuses them.
    """
    with context.database.read() as session:
        unfinished = all_open_jobs(session)
    start(unfinished)
    watchdog = Watchdog(context)
    purpose = "look for unfinished jobs"
    task = Task(
        "watchdog", purpose, lambda: start(watchdog.abandoned()), WATCHDOG_EVERY_S
    )
    with repeating(context, task):
        yield


# Names of processes, by which another process on the same machine can tell that one has
# ended.
_PROC: Final = Path("/proc")
_START_TICK: Final = 19
"""Index of the start time in /proc/PID/stat, counted after the command in brackets."""


def this_process() -> str:
    """A unique name for this process, among all processes of all machines."""
    pid = os.getpid()
    return f"{_machine()}/{pid}/{_started(pid)}/{secrets.token_hex(4)}"


def process_has_ended(name: str) -> bool:
    """Whether the process of this name ran on this machine and has ended.

    False for a process of another machine or container, which cannot be checked.
    """
    machine, _, rest = name.partition("/")
    pid, _, rest = rest.partition("/")
    if machine != _machine() or not pid.isdigit():
        return False
    if sys.platform == "linux":
        # Process ids are reused; together with the start time they are unique.
        return _started(int(pid)) != rest.partition("/")[0]
    if os.name != "posix":
        return False
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        pass  # it runs as another user
    return False


def _machine() -> str:
    if sys.platform != "linux":
        return socket.gethostname().replace("/", "-")
    boot = (_PROC / "sys/kernel/random/boot_id").read_text("ascii").strip()
    # Each container of a machine has its own process ids.
    return f"{boot}-{(_PROC / 'self/ns/pid').stat().st_ino}"


def _started(pid: int) -> str:
    try:
        text = (_PROC / str(pid) / "stat").read_text("utf-8", "replace")
    except OSError:
        return ""
    words = text.rpartition(")")[2].split()
    # A zombie has ended: only its parent has not read its exit status yet.
    return "" if words[0] == "Z" else words[_START_TICK]
