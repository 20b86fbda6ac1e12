"""Leases of jobs have one holder; others take them over if it ended or is silent."""

from datetime import timedelta
from itertools import count
from threading import Event, Thread, Timer

import pytest

from app.db.base import utc_now
from app.db.tables import Lease, Run
from app.engine.chunk import Job
from app.jobs.leases import (
    LEASE_LASTS,
    UNDRIVEN_FOR_S,
    JobLease,
    Leased,
    LeaseLost,
    Leases,
    Watchdog,
    process_has_ended,
    this_process,
)
from app.jobs.queries import job_with_id
from app.jobs.service import cancel
from app.runs.service import RUNS
from tests.support.leases import (
    HOLDER_ELSEWHERE,
    delete_lease,
    ended_process,
    give_lease,
)
from tests.support.services import run_job
from tests.support.waiting import until

_numbers = count(10**6)


@pytest.fixture
def write(services):
    return services.context.database.write


@pytest.fixture
def job():
    return Job("run", next(_numbers))


def take_lease(database, job, holder):
    """Take the lease of a job under the name `holder`, and return it."""
    lease = JobLease(database, job, holder)
    with database.write() as session:
        lease.take(session)
    return lease


def holder_of(context, job):
    with context.database.read() as session:
        lease = session.get(Lease, job)
        return None if lease is None else lease.holder


def test_lease_has_one_holder_until_it_is_released(services, job):
    context = services.context
    lease = take_lease(context.database, job, "one")

    with pytest.raises(LeaseLost):
        take_lease(context.database, job, "two")
    with context.database.write() as session:
        lease.take(session)
        lease.require(session)
    lease.release()
    given_back = holder_of(context, job)
    two = take_lease(context.database, job, "two")
    held = holder_of(context, job)
    two.release()

    # The job of this lease was never queued, so that it counts as ended.
    assert (given_back, held, holder_of(context, job)) == (None, "two", None)


def test_own_renewal_under_way_is_not_taken_for_another_process(postgres_services, job):
    """On SQLite nobody else writes meanwhile."""
    database = postgres_services.context.database
    lease = take_lease(database, job, "one")
    is_renewing, may_end = Event(), Event()

    def renew():
        with database.write_out_of_turn() as session:
            session.get(Lease, job, with_for_update=True)
            is_renewing.set()
            may_end.wait()

    renewing = Thread(target=renew)
    renewing.start()
    is_renewing.wait()
    Timer(0.2, may_end.set).start()
    try:
        with database.write() as session:
            lease.take(session)
    finally:
        may_end.set()
        renewing.join()
        lease.release()


def test_lease_that_expired_or_whose_holder_died_can_be_taken(services, write, job):
    database = services.context.database
    with write() as session:
        give_lease(session, job, ended_process())
        assert Leased.of(session).void >= {job}
    other = take_lease(database, job, HOLDER_ELSEWHERE)

    with pytest.raises(LeaseLost):
        take_lease(database, job, "mine")
    with write() as session:
        row = session.get_one(Lease, job)
        assert timedelta(0) < row.until - utc_now() <= LEASE_LASTS
        assert Leased.of(session).valid >= {job}
        give_lease(session, job, "another-machine/4/5/6", timedelta(0))

    take_lease(database, job, "mine").release()
    other.release()


def test_driver_that_lost_its_lease_raises_before_it_writes(services, write, job):
    context = services.context
    with context.one(Leases).driving(context.database, job) as lease:
        with write() as session:
            lease.take(session)
            lease.require(session)
        with write() as session:
            give_lease(session, job, HOLDER_ELSEWHERE)
        with pytest.raises(LeaseLost), write() as session:
            lease.require(session)
        with pytest.raises(LeaseLost), write() as session:
            lease.take(session)

    assert (
        holder_of(context, job) == HOLDER_ELSEWHERE
    )  # another one's lease is not released
    with write() as session:
        delete_lease(session, job)


def test_job_whose_driver_died_is_abandoned_immediately(services, write):
    street = services.dataset()
    run_id = street.request({})
    job = run_job(run_id)
    watch = Watchdog(services.context)
    assert job not in watch.abandoned()
    with write() as session:
        give_lease(session, job, HOLDER_ELSEWHERE)
    assert job not in watch.abandoned()

    former = ended_process()
    with write() as session:
        give_lease(session, job, former)

    # The watchdog of `services` may have found it first.
    assert job in watch.abandoned() or holder_of(services.context, job) != former
    street.wait(run_id)


def test_job_left_unfinished_by_its_driver_is_abandoned_immediately(services, write):
    context, street = services.context, services.dataset()
    run_id = street.request({})
    watch = Watchdog(context)
    assert run_job(run_id) not in watch.abandoned()

    with context.one(Leases).driving(context.database, run_job(run_id)) as lease:
        with write() as session:
            lease.take(session)
        assert run_job(run_id) not in watch.abandoned()

    # The watchdog of `services` may have found it first; `release` empties the holder.
    abandoned = watch.abandoned()
    assert run_job(run_id) in abandoned or holder_of(context, run_job(run_id)) != ""
    street.wait(run_id)
    until(lambda: holder_of(context, run_job(run_id)) is None)


@pytest.mark.parametrize("ahead", [timedelta(hours=1), timedelta(hours=-1)])
def test_job_without_a_driver_is_abandoned_some_time_after_it_was_driven(
    services, write, ahead
):
    """Its creation time, by the clock of another machine, does not matter."""
    now = [100.0]
    watch = Watchdog(services.context, clock=lambda: now[0])
    run_id = services.dataset().request({})
    job = run_job(run_id)
    with write() as session:
        job_with_id(session, Run, run_id).created_at += ahead

    def are_abandoned():
        for seconds in (0, UNDRIVEN_FOR_S - 1, 2):
            now[0] += seconds
            yield job in watch.abandoned()

    assert list(are_abandoned()) == [False, False, True]
    with write() as session:
        give_lease(session, job, HOLDER_ELSEWHERE)
    assert job not in watch.abandoned()
    with write() as session:
        delete_lease(session, job)
    assert list(are_abandoned()) == [False, False, True]


def test_leases_of_dead_processes_are_deleted_with_their_jobs(services, write):
    holders = ended_process(), HOLDER_ELSEWHERE
    jobs = [run_job(services.dataset().request({})) for _ in holders]
    for job, holder in zip(jobs, holders, strict=True):
        with write() as session:
            cancel(services.context, session, RUNS, job.id)
            give_lease(session, job, holder)

    Watchdog(services.context).abandoned()

    with write() as session:
        left = [session.get(Lease, job) is not None for job in jobs]
        delete_lease(session, jobs[1])
    assert left == [False, True]


def test_process_has_ended_only_for_processes_that_ended():
    machine, pid, started, rest = this_process().split("/")
    with_reused_id = "/".join((machine, pid, str(int(started) - 1), rest))

    ended = [
        process_has_ended(process)
        for process in (ended_process(), with_reused_id, this_process(), "nonsense")
    ]

    assert ended == [True, True, False, False]
    assert not process_has_ended(HOLDER_ELSEWHERE)
    assert this_process() != this_process()
