"""Cancelling a run: it stops soon, stays cancelled and changes no verdict."""

import pytest

from tests.support.api import Api
from tests.support.live import hold_frames
from tests.support.response_checks import assert_matches_model
from tests.support.run_results import post_run
from tests.support.waiting import until
from unghost import wire

FRAMES = 10
SOME = 3
"""How many frames a run has measured when it is cancelled."""
NOTHING_VISIBLE = {"min_visible_pixels": 10**6}


@pytest.fixture
def held(serve):
    """A service, a dataset, and the permits without which no run measures a frame."""
    service = serve(workers=1)
    with service.admin() as http:
        api = Api(http)
        dataset = api.dataset_of_frames(FRAMES)
        with hold_frames() as permits:
            yield service, api, dataset, permits


def start_and_measure_some(api, dataset, permits):
    """Start a run, and wait until it has measured some frames; its id."""
    run_id = post_run(api, dataset)
    permits.release(SOME)
    until(lambda: api.json(f"/runs/{run_id}")["done"] == SOME)
    return run_id


def dataset_and_boxes(api, dataset):
    return api.json(f"/datasets/{dataset}"), api.boxes(dataset, limit=1000)


def test_cancelled_measuring_run_stops_soon_and_changes_nothing(held):
    _, api, dataset, permits = held
    before = dataset_and_boxes(api, dataset)
    run_id = start_and_measure_some(api, dataset, permits)

    response = api.post(f"/runs/{run_id}/cancel")
    # The frame in progress is the last one: the next job begins without more of them.
    permits.release()
    following = api.wait_for_job(
        api.post(f"/datasets/{dataset}/runs", {"config": NOTHING_VISIBLE})
    )

    assert (response.status_code, response.json()["state"]) == (202, "cancelled")
    assert response.headers["location"].endswith(f"/runs/{run_id}")
    assert_matches_model(wire.Run, response.json())
    assert following["state"] == "done"
    assert dataset_and_boxes(api, dataset) == before
    run = api.json(f"/runs/{run_id}")
    assert run["finished_at"] is not None
    assert (run["state"], run["done"], run["changed"]) == ("cancelled", SOME, 0)


def test_frames_measured_by_a_cancelled_run_are_not_measured_again(held):
    _, api, dataset, permits = held
    first = start_and_measure_some(api, dataset, permits)
    api.post(f"/runs/{first}/cancel")
    permits.release()

    again = post_run(api, dataset)
    until(lambda: api.json(f"/runs/{again}")["state"] == "running")
    begun = api.json(f"/runs/{again}")["done"]
    permits.release(FRAMES)
    until(lambda: api.json(f"/runs/{again}")["state"] == "done")

    assert begun == SOME
    assert api.json(f"/runs/{again}")["done"] == FRAMES
    assert api.json(f"/datasets/{dataset}/stats")["kept"] == FRAMES


def test_cancelled_queued_run_never_starts(held):
    _, api, dataset, permits = held
    working = post_run(api, dataset)
    waiting = post_run(api, dataset, NOTHING_VISIBLE)

    response = api.post(f"/runs/{waiting}/cancel")
    api.post(f"/runs/{working}/cancel")
    permits.release()
    following = api.run(dataset, {})

    assert (response.status_code, following["state"]) == (202, "done")
    run = api.json(f"/runs/{waiting}")
    assert (run["state"], run["started_at"]) == ("cancelled", None)


def test_second_cancel_returns_409_but_idempotency_key_replays_it(held):
    _, api, dataset, _ = held
    working = post_run(api, dataset)
    url = f"/api/v1/runs/{working}/cancel"

    first, again = (
        api.http.post(url, headers={"Idempotency-Key": "once"}) for _ in range(2)
    )
    other = api.http.post(url)
    missing = api.post("/runs/999999/cancel")

    assert missing.status_code == 404
    assert (first.status_code, again.status_code, other.status_code) == (202, 202, 409)
    assert first.json() == again.json()
    assert other.json()["detail"] == f"run {working} is cancelled already"


def test_deleting_a_dataset_during_its_run_logs_no_failure(held, caplog):
    """Such a run used to be logged as a job that failed."""
    _, api, dataset, permits = held
    start_and_measure_some(api, dataset, permits)

    api.remove(dataset)
    permits.release()
    other = api.dataset_of_one_frame()

    assert api.run(other, NOTHING_VISIBLE)["state"] == "done"
    assert "failed" not in caplog.text
    assert "Traceback" not in caplog.text
