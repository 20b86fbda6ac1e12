"""Leases of processes that are dead, or on another machine."""

from __future__ import annotations

import subprocess
import sys

from app.db.base import utc_now
from app.db.tables import Lease
from app.jobs.leases import LEASE_LASTS

ELSEWHERE = "another-machine/1/2/3"
"""The name of a process of which nobody here can tell whether it has ended."""
WHO = "from app.jobs.leases import this_process; print(this_process())"


def give(session, job, holder, lasts=LEASE_LASTS):
    """Let this process have the lease of a job, whoever has it now."""
    session.merge(
        Lease(kind=job.kind, job_id=job.id, holder=holder, until=utc_now() + lasts)
    )
    session.flush()


def take_away(session, job):
    """Leave a job without a lease."""
    if (lease := session.get(Lease, job)) is not None:
        session.delete(lease)
        session.flush()


def ended_process():
    """The holder name of a process of this machine that has ended."""
    done = subprocess.run(
        [sys.executable, "-c", WHO], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()
