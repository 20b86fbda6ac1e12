"""Cancelling a run: it stops soon, stays cancelled and changes no verdict."""

from __future__ import annotations

import time

from tests.support import frames as scene
from tests.support.api import Api
from tests.support.event_reader import events, open_events
from tests.support.response_checks import assert_matches_model
from tests.support.slow_datasets import FROM_PIXELS, OTHER_PIXELS, create_slow_dataset
from unghost import wire

FRAMES = 60
AT_ONCE_S = 10
"""More seconds than a busy machine takes for something that needs no work."""
NOTHING_VISIBLE = {"min_visible_pixels": 10**6}


def start_run(api, dataset, config, *, activate=True):
    body = {"config": config, "activate": activate}
    answer = api.post(f"/datasets/{dataset}/runs", body)
    assert answer.status_code == 202, answer.text
    return answer.json()["id"]


def wait_until_part_way(api, run_id):
    """Wait until some frames are measured; return the run as it was then."""
    with open_events(api, run_id) as stream:
        return next(event.data for event in stream if event.data["done"])


def dataset_and_boxes(api, dataset):
    return api.json(f"/datasets/{dataset}"), api.boxes(dataset, limit=1000)


def test_cancelled_measuring_run_stops_soon_and_changes_nothing(slow):
    _, api, dataset = slow
    before = dataset_and_boxes(api, dataset)
    run_id = start_run(api, dataset, FROM_PIXELS)
    seen = wait_until_part_way(api, run_id)

    begun = time.monotonic()
    answer = api.post(f"/runs/{run_id}/cancel")
    cancelled = time.monotonic() - begun
    # The next job begins only when the cancelled one has stopped.
    following = api.wait_for_job(
        api.post(f"/datasets/{dataset}/runs", {"config": NOTHING_VISIBLE})
    )
    freed = time.monotonic() - begun

    assert 0 < seen["done"] < FRAMES
    assert (answer.status_code, answer.json()["state"]) == (202, "cancelled")
    assert answer.headers["location"].endswith(f"/runs/{run_id}")
    assert_matches_model(wire.Run, answer.json())
    assert cancelled < AT_ONCE_S
    assert freed < AT_ONCE_S
    assert api.json(f"/runs/{run_id}")["done"] < FRAMES
    assert following["state"] == "done"
    assert dataset_and_boxes(api, dataset) == before
    run = api.json(f"/runs/{run_id}")
    assert run["finished_at"] is not None
    assert (run["state"], run["done"] < FRAMES, run["changed"]) == (
        *("cancelled", True),
        0,
    )


def test_frames_measured_by_a_cancelled_run_are_not_measured_again(slow):
    _, api, dataset = slow
    first = start_run(api, dataset, OTHER_PIXELS[0])
    wait_until_part_way(api, first)
    kept = api.post(f"/runs/{first}/cancel").json()["done"]

    again = start_run(api, dataset, OTHER_PIXELS[0])
    found = events(api, again)

    begun = [event.data["done"] for event in found if event.data["started_at"]]
    assert begun[0] >= kept > 0
    assert (found[-1].data["state"], found[-1].data["done"]) == ("done", FRAMES)
    assert api.json(f"/datasets/{dataset}/stats")["kept"] == FRAMES


def test_cancelled_queued_run_never_starts(slow):
    _, api, dataset = slow
    working = start_run(api, dataset, OTHER_PIXELS[1])
    waiting = start_run(api, dataset, NOTHING_VISIBLE)

    answer = api.post(f"/runs/{waiting}/cancel")
    api.post(f"/runs/{working}/cancel")
    following = api.run(dataset, {})

    assert (answer.status_code, following["state"]) == (202, "done")
    run = api.json(f"/runs/{waiting}")
    assert (run["state"], run["started_at"]) == ("cancelled", None)


def test_cancelling_a_finished_run_returns_409(api):
    dataset = api.dataset_of_one_frame()
    run = api.run(dataset, NOTHING_VISIBLE)

    answer = api.post(f"/runs/{run['id']}/cancel")

    assert (answer.status_code, answer.json()["code"]) == (409, "run_over")
    assert answer.json()["detail"] == f"run {run['id']} is done already"
    assert api.json(f"/runs/{run['id']}") == run


def test_second_cancel_returns_409_but_idempotency_key_replays_it(slow):
    _, api, dataset = slow
    working = start_run(api, dataset, OTHER_PIXELS[2])
    url = f"/api/v1/runs/{working}/cancel"

    first, again = (
        api.http.post(url, headers={"Idempotency-Key": "once"}) for _ in range(2)
    )
    other = api.http.post(url)

    assert (first.status_code, again.status_code, other.status_code) == (202, 202, 409)
    assert first.json() == again.json()
    assert other.json()["detail"] == f"run {working} is cancelled already"


def test_cancelling_a_missing_run_returns_404(api):
    assert api.post("/runs/999999/cancel").status_code == 404


def test_cancelling_a_run_is_forbidden_to_a_viewer(slow):
    server, api, dataset = slow
    token = api.post("/tokens", {"name": "viewer", "role": "viewer"}).json()["token"]
    viewer = Api.at(server.url, {"Authorization": f"Bearer {token}"})
    working = start_run(api, dataset, OTHER_PIXELS[3])

    with viewer.http:
        answer = viewer.post(f"/runs/{working}/cancel")

    assert answer.status_code == 403
    assert api.post(f"/runs/{working}/cancel").status_code == 202


def test_deleting_a_dataset_during_its_run_logs_no_failure(slow):
    """Such a run used to be logged as a job that failed."""
    server, api, _ = slow
    dataset = create_slow_dataset(api, 40)
    run_id = start_run(api, dataset, FROM_PIXELS)
    wait_until_part_way(api, run_id)

    gone = api.http.delete(f"/api/v1/datasets/{dataset}", params={"confirm": dataset})
    other = api.dataset()
    api.upload_frame(other, "a", {**scene.annotation()})

    assert gone.status_code == 204
    assert api.run(other, NOTHING_VISIBLE)["state"] == "done"
    log = server.log.read_text("utf-8")
    assert "failed" not in log
    assert "Traceback" not in log
