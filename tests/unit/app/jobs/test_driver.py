"""The driver of a run, with chunks that are repeated, lost or kill their workers.

The engines are local ones with such faults; the driver does the same with any engine.
"""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from app.db.engine import Database
from app.db.tables import Chunk, Lease
from app.engine.chunk import DONE, ELSEWHERE, RETURNED
from app.jobs.attempts import MOST_ATTEMPTS
from app.jobs.driver import drive_job
from app.jobs.work import work_in_worker, work_on_chunk
from tests.support.chunks import (
    FRAMES,
    FROM_PIXELS,
    CrashingEngine,
    DisconnectingEngine,
    SmallChunks,
    check_run_is_complete,
    context_with_engine,
    measured,
    remaining_rows,
    run_of,
)
from tests.support.leases import HOLDER_ELSEWHERE, delete_lease, give_lease
from tests.support.services import run_job


def run_with(street, engine):
    run_id = street.request(FROM_PIXELS)
    with context_with_engine(street, engine) as context:
        drive_job(context, run_job(run_id))
    return run_of(street, run_id)


def test_concurrent_chunks_measure_each_frame_once(street):
    engine = SmallChunks()

    run = run_with(street, engine)

    check_run_is_complete(street, run)
    assert sorted(number for number, _ in engine.begun) == [1, 2, 3, 4]
    assert (
        remaining_rows(street, Chunk, run) == remaining_rows(street, Lease, run) == []
    )


def test_driver_reconnects_to_a_lost_engine_and_resubmits_chunks(street):
    engine = DisconnectingEngine()

    run = run_with(street, engine)

    check_run_is_complete(street, run)
    assert engine.connects >= 2
    assert len(engine.begun) > 4


def test_chunk_that_kills_its_worker_is_quarantined_and_no_other(street):
    engine = CrashingEngine(2)

    run = run_with(street, engine)

    assert run.state == "failed"
    assert run.error is not None
    assert run.error["code"] == "quarantined"
    # First its first frame, after three deaths, and after three more all behind it.
    assert "frames '03', '04' to '05' crashed" in run.error["detail"]
    chunks = {
        chunk.number: (chunk.state, chunk.frames, chunk.attempts)
        for chunk in remaining_rows(street, Chunk, run)
    }
    assert chunks == {
        5: ("quarantined", 1, MOST_ATTEMPTS),
        2: ("quarantined", 2, MOST_ATTEMPTS),
    }
    assert len(measured(street, run)) == FRAMES - 3
    assert run.done == FRAMES - 3


def test_chunks_beside_a_dead_process_are_retried_one_at_a_time(street):
    engine = CrashingEngine(2, times=2)

    run = run_with(street, engine)

    check_run_is_complete(street, run)
    again = [beside for number, beside in engine.begun[4:]]
    assert again
    assert {len(beside) for beside in again} == {1}


def test_returned_chunk_is_retried_without_other_chunks(street):
    """The worker of the second attempt stops, so the cause is still unknown."""

    class Stopping(CrashingEngine):
        def _work(self, here, job, number):
            tries = [chunk for chunk, _ in self.begun if chunk == number]
            if number == 2 and len(tries) == 2:
                return RETURNED
            return super()._work(here, job, number)

    engine = Stopping(2, times=1)

    run = run_with(street, engine)

    check_run_is_complete(street, run)
    beside = [beside for number, beside in engine.begun if number == 2]
    assert beside[2:] == [{2}]


def test_chunk_that_is_worked_on_twice_counts_once(street):
    class Twice(SmallChunks):
        def _work(self, here, job, number):
            with ThreadPoolExecutor(1) as beside:
                other = beside.submit(here, job.kind, job.id, number)
                first = here(job.kind, job.id, number)
                assert {first, other.result()} == {DONE}
            return super()._work(here, job, number)

    check_run_is_complete(street, run_with(street, Twice()))


def test_two_drivers_end_a_run_once(street):
    run_id = street.request(FROM_PIXELS)
    with (
        context_with_engine(street, SmallChunks()) as first,
        context_with_engine(street, SmallChunks()) as two,
    ):
        contexts = [first, replace(two, owned={})]
        drivers = [
            threading.Thread(target=drive_job, args=(context, run_job(run_id)))
            for context in contexts
        ]
        for driver in drivers:
            driver.start()
        for driver in drivers:
            driver.join()

    run = run_of(street, run_id)
    check_run_is_complete(street, run)
    entries = street.history(street.box_ids()[0])
    assert [entry["run"] for entry in entries].count(run_id) <= 1


def test_driver_that_lost_its_lease_does_not_end_the_run(street):
    run_id = street.request(FROM_PIXELS)
    before = street.reasons()

    class LosesItsLease(SmallChunks):
        def _work(self, here, job, number):
            with street.context.database.write() as session:
                give_lease(session, job, HOLDER_ELSEWHERE)
            return super()._work(here, job, number)

    with context_with_engine(street, LosesItsLease()) as context:
        drive_job(context, run_job(run_id))
    run = run_of(street, run_id)
    assert run.state == "running"
    assert street.reasons() == before

    with street.context.database.write() as session:
        delete_lease(session, run_job(run_id))
    drive_job(street.context, run_job(run_id))
    check_run_is_complete(street, run_of(street, run_id))


def test_worker_of_another_installation_fails_the_run(street):
    run_id = street.request(FROM_PIXELS)
    job = ("run", run_id, 1)

    assert work_in_worker(street.context, job, "another one") == ELSEWHERE

    class Elsewhere(SmallChunks):
        def start_chunk(self, here, job, number):
            return self.run_later(lambda: ELSEWHERE)

    with context_with_engine(street, Elsewhere()) as context:
        drive_job(context, run_job(run_id))
    run = run_of(street, run_id)
    assert run.error is not None
    assert (run.state, run.error["code"]) == ("failed", "worker_elsewhere")


def test_chunk_of_a_finished_run_is_unwanted_and_one_without_a_database_returned(
    street,
):
    run = street.run({"threshold_small_box": 99})
    nowhere = Database("postgresql+psycopg://postgres@127.0.0.1:1/nowhere")
    away = replace(street.context, database=nowhere)

    assert work_on_chunk(street.context, "run", run.id, 1) == "unwanted"
    assert work_in_worker(away, ("run", 1, 1), "one") == RETURNED
