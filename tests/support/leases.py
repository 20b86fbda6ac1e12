"""Gives leases of jobs to processes that have ended or are on another machine."""

from __future__ import annotations

import subprocess
import sys
from datetime import timedelta

from app.db.base import utc_now
from app.db.tables import Lease

HOLDER_ELSEWHERE = "another-machine/1/2/3"
"""A holder's name on another machine: from here nobody can tell if it has ended."""
PRINT_THIS_PROCESS = "from app.jobs.leases import this_process; print(this_process())"


def give_lease(session, job, holder, lasts=timedelta(hours=1)):
    """Give `holder` the lease of a job, in place of the present holder.

    It lasts longer than any test, unless `lasts` says otherwise.
    """
    session.merge(
        Lease(kind=job.kind, job_id=job.id, holder=holder, until=utc_now() + lasts)
    )
    session.flush()


def delete_lease(session, job):
    """Delete the lease of a job."""
    if (lease := session.get(Lease, job)) is not None:
        session.delete(lease)
        session.flush()


def ended_process():
    """The holder's name of a process of this machine that has already ended."""
    done = subprocess.run(
        [sys.executable, "-c", PRINT_THIS_PROCESS],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()
