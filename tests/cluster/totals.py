"""What is the same wherever and however often a run was worked on."""

from __future__ import annotations

from collections import Counter
from typing import Any

from tests.api.resources import FINISHED, Api
from tests.cluster.nodes import until


def state_of(api: Api, run_id: int) -> dict[str, Any]:
    run: dict[str, Any] = api.json(f"/runs/{run_id}")
    return run


def has_begun(api: Api, run_id: int) -> None:
    """Wait until some frames are measured, and not all."""
    until(lambda: state_of(api, run_id)["done"] > 0, "the run does not begin")


def ended(api: Api, run_id: int) -> dict[str, Any]:
    until(lambda: state_of(api, run_id)["state"] in FINISHED, "the run does not end")
    return state_of(api, run_id)


def check_totals(api: Api, dataset: str, run: dict[str, Any], frames: int) -> None:
    """Nothing is lost, and nothing is there twice."""
    assert (run["state"], run["done"], run["total"]) == ("done", frames, frames), run
    shown = api.boxes(dataset, limit=1000)
    assert Counter(box["verdict"] for box in shown) == Counter(run["counts"])
    assert {box["run"] for box in shown} == {run["id"]}
