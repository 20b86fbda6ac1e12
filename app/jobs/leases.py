"""Leases: each job has one driver, the process that holds and renews its lease.

A lease is taken in the transaction that begins the job. A process that renews too late
loses it to another one, and notices when it renews the lease, plans chunks or begins
the final step. If two processes reach the end of a job, the first one ends it, and the
second finds that it has ended.
"""

from __future__ import annotations

import logging
import os
import secrets
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.db.engine import Database, once_committed
from app.engine import Job, JobStopped
from app.jobs.kind import kind_of
from app.jobs.queries import OPEN, LeaseRepository, find_job

RENEW_EVERY_S: Final = 2.0

log = logging.getLogger(__name__)


class LeaseLost(JobStopped):
    """Another process drives the job: this one must not write to it any more."""


class JobLease:
    """The lease of one job that this process drives."""

    def __init__(self, database: Database, job: Job, holder: str) -> None:
        self.job = job
        self._database, self._holder = database, holder
        self._over, self._is_mine, self._is_lost = threading.Event(), False, False

    def take(self, session: Session) -> None:
        """Take the lease in the transaction that begins the job, and keep renewing it.

        Raises
        ------
        LeaseLost
            Another process drives the job.
        """
        if not LeaseRepository(session).take(self.job, self._holder, has_ended):
            raise LeaseLost(self.job)
        once_committed(session, self._keep)

    def require(self, session: Session) -> None:
        """Lock the lease until this transaction ends, so that no other can take it.

        Raises
        ------
        LeaseLost
            Another process has taken it already.
        """
        if not LeaseRepository(session).is_held(self.job, self._holder):
            raise LeaseLost(self.job)

    def end(self, session: Session) -> None:
        """Remove the lease in the transaction in which the job fails.

        Raises
        ------
        LeaseLost
            Another process has taken it already.
        """
        self.require(session)
        LeaseRepository(session).end(self.job, self._holder)
        once_committed(session, self._forget)

    def check(self) -> None:
        """Raise `LeaseLost` if the last renewal found that another process has it."""
        if self._is_lost:
            raise LeaseLost(self.job)

    def release(self) -> None:
        """Give up the lease: this process no longer drives the job.

        If the job has not ended, the watchdog of any process can take it over.
        """
        self._over.set()
        if not self._is_mine or self._is_lost:
            return
        try:
            with self._database.write_beside() as session:
                leases = LeaseRepository(session)
                row = find_job(session, kind_of(self.job).table, self.job.id)
                if row is not None and row.state in OPEN:
                    leases.leave(self.job, self._holder)
                else:
                    leases.end(self.job, self._holder)
        except SQLAlchemyError as exc:  # the lease expires by itself
            log.warning("cannot release the lease of %s %d: %s", *self.job, exc)

    def _keep(self) -> None:
        self._is_mine = True
        threading.Thread(target=self._renew, name="lease", daemon=True).start()

    def _forget(self) -> None:
        self._is_mine = False
        self._over.set()

    def _renew(self) -> None:
        while not self._over.wait(RENEW_EVERY_S):
            try:
                with self._database.write_beside() as session:
                    mine = LeaseRepository(session).renew(self.job, self._holder)
            except SQLAlchemyError as exc:  # retried until the lease expires
                log.warning("cannot renew the lease of %s %d: %s", *self.job, exc)
                continue
            if not mine and not self._over.is_set():
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


_PROC: Final = Path("/proc")
_START_TICK: Final = 19
"""Index of the start time in /proc/PID/stat, counted after the command in brackets."""


def this_process() -> str:
    """A unique name for this process, among all processes of all machines."""
    pid = os.getpid()
    return f"{_machine()}/{pid}/{_started(pid)}/{secrets.token_hex(4)}"


def has_ended(name: str) -> bool:
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
    return os.name == "posix" and not _answers(int(pid))


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


def _answers(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
