"""Leases: one holder, taken over when it died or fell silent."""

from __future__ import annotations

from datetime import timedelta
from itertools import count

import pytest

from app.db.tables import Lease
from app.engine import Job
from app.jobs.leases import LeaseLost, Leases, has_ended, this_process
from app.jobs.queries import LEASE_LASTS, LeaseRepository
from app.jobs.service import UNDRIVEN_FOR_S, Watchdog, cancel
from app.runs.queries import RunRepository
from app.runs.service import RUNS
from tests.support.leases import ended_process, nobody
from tests.support.services import run_job
from tests.support.waiting import until

ELSEWHERE = "another-machine/1/2/3"
_numbers = count(10**6)


@pytest.fixture
def write(services):
    return services.context.database.write


@pytest.fixture
def job():
    return Job("run", next(_numbers))


def has_lease(context, job):
    with context.database.read() as session:
        return session.get(Lease, job) is not None


def test_a_process_knows_itself_and_the_dead_from_the_living():
    assert this_process() != this_process()
    assert not has_ended(this_process())
    assert has_ended(ended_process())
    assert not has_ended(ELSEWHERE)
    assert not has_ended("nonsense")


def test_a_number_that_another_process_has_by_now_is_no_sign_of_life():
    machine, pid, started, rest = this_process().split("/")

    assert has_ended("/".join((machine, pid, str(int(started) - 1), rest)))


def test_a_lease_has_one_holder_until_it_is_given_back(write, job):
    with write() as session:
        leases = LeaseRepository(session)
        taken = [leases.take(job, who, nobody) for who in ("one", "two", "one")]
        renewed = [leases.renew(job, who) for who in ("one", "two")]
        leases.end(job, "two")
        held = leases.is_held(job, "one")
        leases.end(job, "one")
        afterwards = leases.take(job, "two", nobody)
        leases.end(job, "two")

    assert taken == [True, False, True]
    assert renewed == [True, False]
    assert (held, afterwards) == (True, True)


def test_a_lease_that_ran_out_or_whose_holder_died_is_anybodys(write, job):
    dead = ended_process()
    with write() as session:
        leases = LeaseRepository(session)
        assert leases.take(job, dead, nobody)
        assert leases.leased_jobs(has_ended).void >= {job}
        assert leases.take(job, ELSEWHERE, has_ended)
        assert not leases.take(job, "mine", has_ended)
        row = session.get(Lease, (job.kind, job.id))
        assert row is not None
        assert timedelta(0) < row.until - leases.now() <= LEASE_LASTS
        row.until = leases.now()
        session.flush()
        assert leases.take(job, "mine", has_ended)
        leases.end(job, "mine")


def test_a_driver_that_lost_its_lease_finds_out_before_it_writes(services, write, job):
    context = services.context
    with context.one(Leases).driving(context.database, job) as lease:
        with write() as session:
            lease.take(session)
            lease.require(session)
        with write() as session:
            assert LeaseRepository(session).take(job, ELSEWHERE, lambda _: True)
        with pytest.raises(LeaseLost), write() as session:
            lease.require(session)
        with pytest.raises(LeaseLost), write() as session:
            lease.end(session)

    with write() as session:
        leases = LeaseRepository(session)
        assert leases.is_held(job, ELSEWHERE)  # it was not ours to give back
        leases.end(job, ELSEWHERE)


def test_a_job_whose_driver_died_is_found_at_once(services, write):
    street = services.dataset()
    run_id = street.request({})
    job = run_job(run_id)
    watch = Watchdog(services.context)
    assert job not in watch.abandoned()
    with write() as session:
        leases = LeaseRepository(session)
        assert leases.take(job, ELSEWHERE, has_ended)
    assert job not in watch.abandoned()

    with write() as session:
        leases = LeaseRepository(session)
        leases.end(job, ELSEWHERE)
        assert leases.take(job, ended_process(), has_ended)

    assert job in watch.abandoned()
    street.wait(run_id)


def test_a_job_that_its_driver_leaves_unfinished_is_found_at_once(services, write):
    context, street = services.context, services.dataset()
    run_id = street.request({})
    watch = Watchdog(context)
    assert run_job(run_id) not in watch.abandoned()

    with context.one(Leases).driving(context.database, run_job(run_id)) as lease:
        with write() as session:
            lease.take(session)
        assert run_job(run_id) not in watch.abandoned()

    assert run_job(run_id) in watch.abandoned()
    street.wait(run_id)
    until(lambda: not has_lease(context, run_job(run_id)))


@pytest.mark.parametrize("ahead", [timedelta(hours=1), timedelta(hours=-1)])
def test_a_job_that_nobody_begins_is_found_whatever_the_clock_of_who_asked(
    services, write, ahead
):
    now = [100.0]
    watch = Watchdog(services.context, clock=lambda: now[0])
    run_id = services.dataset().request({})
    with write() as session:
        RunRepository(session).with_id(run_id).created_at += ahead

    seen = []
    for seconds in (0, UNDRIVEN_FOR_S - 1, 2):
        now[0] += seconds
        seen.append(run_job(run_id) in watch.abandoned())

    assert seen == [False, False, True]


def test_a_job_waits_anew_once_somebody_has_driven_it(services, write):
    now = [100.0]
    watch = Watchdog(services.context, clock=lambda: now[0])
    run_id = services.dataset().request({})
    watch.abandoned()
    now[0] += UNDRIVEN_FOR_S

    with write() as session:
        assert LeaseRepository(session).take(run_job(run_id), ELSEWHERE, has_ended)
    driven = watch.abandoned()
    with write() as session:
        LeaseRepository(session).end(run_job(run_id), ELSEWHERE)

    assert run_job(run_id) not in driven + watch.abandoned()


def test_leases_of_the_dead_go_with_their_jobs(services, write):
    holders = ended_process(), ELSEWHERE
    jobs = [run_job(services.dataset().request({})) for _ in holders]
    for job, holder in zip(jobs, holders, strict=True):
        with write() as session:
            assert LeaseRepository(session).take(job, holder, nobody)
    # Only now: when a run ends, the service begins those that are nobody's.
    for job in jobs:
        with write() as session:
            cancel(services.context, session, RUNS, job.id)

    Watchdog(services.context).abandoned()

    with write() as session:
        left = [session.get(Lease, job) is not None for job in jobs]
        LeaseRepository(session).end(jobs[1], ELSEWHERE)
    assert left == [False, True]
