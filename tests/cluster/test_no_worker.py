"""A service whose scheduler has no workers logs that at once, then only rarely."""

import time

import pytest

from app.engine.cluster import COUNTED_FOR_S, LOG_AGAIN_S, AbsenceLog
from tests.support.cluster import cluster
from tests.support.run_results import check_run_results, wait_for_run_end
from tests.support.slow_datasets import FROM_PIXELS, create_slow_dataset
from tests.support.waiting import until

MESSAGE = "no worker has joined"


def test_absence_of_workers_is_logged_at_once_and_then_rarely():
    now = [0.0]
    absence = AbsenceLog(clock=lambda: now[0])

    told = []
    for seconds, present in (
        *((0, True), (2, False), (2, False), (LOG_AGAIN_S - 3, False), (2, False)),
        *((2, False), (2, True), (2, False)),
    ):
        now[0] += seconds
        told.append(absence.is_due(absent=not present))

    assert told == [False, True, False, False, True, False, False, True]


@pytest.mark.long
def test_service_without_workers_logs_that_only_once(tmp_path):
    with cluster(tmp_path) as made:
        made.scheduler()
        with made.server() as (server, api):
            name = create_slow_dataset(api, 1)
            body = {"config": FROM_PIXELS, "activate": True}
            run_id = api.post(f"/datasets/{name}/runs", body).json()["id"]
            until(lambda: MESSAGE in server.log.read_text("utf-8"), "it says nothing")
            # In this time the service counts the workers several times.
            time.sleep(3 * COUNTED_FOR_S)
            said = server.log.read_text("utf-8").count(MESSAGE)
            made.worker()
            check_run_results(api, name, wait_for_run_end(api, run_id), 1)

    assert said == 1
