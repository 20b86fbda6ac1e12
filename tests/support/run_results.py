"""Starts runs, waits for them, and checks that their results are complete."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from tests.support.api import FINISHED, Api
from tests.support.slow_datasets import FROM_PIXELS
from tests.support.waiting import LOOK_EVERY_S, until


def get_run(api: Api, run_id: int) -> dict[str, Any]:
    run: dict[str, Any] = api.json(f"/runs/{run_id}")
    return run


def post_run(
    api: Api,
    dataset: str,
    config: Mapping[str, Any] = FROM_PIXELS,
    *,
    activate: bool = True,
) -> int:
    """Request a run that has to read pixels; returns its id."""
    body = {"config": config, "activate": activate}
    response = api.post(f"/datasets/{dataset}/runs", body)
    assert response.status_code == 202, response.text
    return int(response.json()["id"])


def start_run(
    api: Api,
    dataset: str,
    config: Mapping[str, Any] = FROM_PIXELS,
    *,
    activate: bool = True,
) -> int:
    """Request a run, and wait until it has measured some frames; returns its id."""
    run_id = post_run(api, dataset, config, activate=activate)
    begun = "the run does not begin"
    # It may be over soon.
    until(lambda: get_run(api, run_id)["done"] > 0, begun, every_s=LOOK_EVERY_S)
    return run_id


def wait_for_run_end(api: Api, run_id: int) -> dict[str, Any]:
    until(lambda: get_run(api, run_id)["state"] in FINISHED, "the run does not end")
    return get_run(api, run_id)


def check_run_results(
    api: Api, dataset: str, run: dict[str, Any], frames: int, *, empty: int = 0
) -> None:
    """Check that a run's results are complete, as if no process had died meanwhile.

    Every box must be there once, with the right verdict. `empty` of the frames have no
    boxes; the others are those of `create_slow_dataset`.
    """
    assert (run["state"], run["done"], run["total"]) == ("done", frames, frames), run
    shown = api.boxes(dataset, limit=1000)
    filled = frames - empty
    assert Counter((box["id"], box["verdict"]) for box in shown) == {
        ("real", "kept"): filled,
        ("ghost", "rejected"): filled,
    }
    assert len({box["box_id"] for box in shown}) == len(shown)
    assert Counter(box["verdict"] for box in shown) == Counter(run["counts"])
    assert {box["run"] for box in shown} == {run["id"]}
