"""PostgreSQL is killed while the workers of a cluster measure for a run."""

import time

import httpx
import pytest

from tests.support.api import FINISHED
from tests.support.cluster import cluster
from tests.support.postgres_cluster import own_cluster
from tests.support.run_results import check_run_results, get_run, start_run
from tests.support.slow_datasets import create_slow_dataset
from tests.support.waiting import until

FRAMES = 80
OUTAGE_S = 2

pytestmark = pytest.mark.long


def test_run_completes_after_the_database_is_killed_and_restarted(tmp_path):
    with own_cluster() as postgres, cluster(tmp_path) as made:
        made.settings["UNGHOST_DATABASE_URL"] = postgres.url
        made.scheduler()
        with made.server() as (_, api):
            workers = [made.worker() for _ in range(2)]
            street = create_slow_dataset(api, FRAMES)
            run_id = start_run(api, street)

            postgres.kill()
            time.sleep(OUTAGE_S)
            postgres.start()

            until(lambda: is_over(api, run_id), "the run does not end")
            check_run_results(api, street, get_run(api, run_id), FRAMES)
            assert [worker.process.poll() for worker in workers] == [None, None]


def is_over(api, run_id) -> bool:
    """Whether a run has ended; False while the service answers 503."""
    response: httpx.Response = api.get(f"/runs/{run_id}")
    assert response.status_code in (200, 503), response.text
    return response.status_code == 200 and response.json()["state"] in FINISHED
