"""Gives leases of jobs to processes that have ended or are on another machine."""

import subprocess
import sys
from datetime import timedelta
from functools import cache

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


@cache
def ended_process():
    """The holder's name of a process of this machine that has already ended.

    It is the same one for all tests: a process may hold the leases of many jobs.
    """
    done = subprocess.run(
        [sys.executable, "-c", PRINT_THIS_PROCESS],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()
