"""While one service decides a run, another one sees its progress and can cancel it."""

from contextlib import contextmanager
from threading import Thread

import pytest

from app.datasets.service import remove_dataset
from app.db.tables import Run
from app.jobs.driver import drive_job
from app.jobs.queries import job_with_id
from app.jobs.service import cancel
from app.runs.service import RUNS
from tests.support.databases import migrated_postgres
from tests.support.large_datasets import DatasetSpec, make_dataset
from tests.support.services import ServiceDataset, run_job, running_services
from tests.support.waiting import LOOK_EVERY_S, until

FRAMES = 8_000
"""They have 15 boxes each: so many that changing their decisions takes seconds."""
NOTHING_VISIBLE = {"min_visible_pixels": 10**6}


@pytest.fixture(scope="module")
def services(tmp_path_factory):
    """Two services that share one database, which is always PostgreSQL."""
    folder = tmp_path_factory.mktemp("shared")
    with (
        migrated_postgres() as url,
        running_services(folder, database_url=url) as first,
        running_services(folder, database_url=url) as other,
    ):
        yield first, other


@pytest.fixture(scope="module")
def street(services):
    service, _ = services
    dataset_id = make_dataset(
        service.context, DatasetSpec("many", FRAMES, 15), lambda _boxes: None
    )
    return ServiceDataset(service, "many", dataset_id)


def state_and_progress(services, run_id):
    with services.context.database.read() as session:
        run = job_with_id(session, Run, run_id)
        return run.state, run.done


def wait_for_progress(services, run_id):
    """Wait until a service sees progress of another one's run; returns its state."""

    def state_at_progress():
        state, done = state_and_progress(services, run_id)
        if 0 < done < FRAMES:
            return state
        assert state in ("queued", "running")
        return None

    return until(state_at_progress, "no progress was reported", every_s=LOOK_EVERY_S)


@contextmanager
def drive_in_thread(services, run_id):
    """Drive a run in a thread; at its end, the block waits for the run."""
    driver = Thread(target=drive_job, args=(services.context, run_job(run_id)))
    driver.start()
    try:
        yield
    finally:
        driver.join()


@pytest.mark.long
def test_run_being_decided_is_followed_and_cancelled_by_another_service(
    services, street
):
    first, other = services
    run_id = street.request(NOTHING_VISIBLE)
    before = street.reasons()
    with drive_in_thread(first, run_id):
        state = wait_for_progress(other, run_id)
        with other.context.database.write() as session:
            cancelled = cancel(other.context, session, RUNS, run_id).state

    assert (state, cancelled) == ("running", "cancelled")
    assert state_and_progress(first, run_id)[0] == "cancelled"
    assert street.reasons() == before
    # The same run again, which is not cancelled.
    assert street.run(NOTHING_VISIBLE).changed > 0
    # Deleting the dataset cancels a decision as well, instead of waiting for it.
    run_id = street.request({})
    with drive_in_thread(first, run_id):
        wait_for_progress(other, run_id)
        with other.context.database.write() as session:
            remove_dataset(other.context, session, street.name, street.name)
    with first.context.database.read() as session:
        assert session.get_one(Run, run_id).state == "cancelled"
