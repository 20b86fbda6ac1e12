"""Compares responses of the service with the models of `unghost.wire`."""

from typing import Any

import httpx

from unghost.wire.model import ResponseModel


def successful_json(response: httpx.Response) -> Any:
    assert response.is_success, response.text
    return response.json()


def assert_matches_model(kind: type[ResponseModel], raw: Any) -> None:
    """Check that a response has exactly the keys of a model, at any depth.

    Fields of response models have no defaults, so a key that the service leaves out
    fails here. The model's lenient reader must read the same values.
    """
    checked = kind.model_validate(raw)

    assert checked.model_dump(mode="json") == raw
    assert kind.read(raw) == checked


COUNTS = {
    "frames": 1,
    "boxes": 6,
    "kept": 1,
    "rejected": 2,
    "unmeasured": 3,
    "reviewed": 0,
    "to_review": 5,
    "problems": 0,
}
DATASET = {
    "name": "town",
    "classes": ["car"],
    "palette": "auto",
    "encoding": "auto",
    "channel_order": "auto",
    "lossy_segmentation": "refuse",
    "created_at": "2026-01-01T00:00:00Z",
    "config": "c0ffee",
    "active_run": 1,
    "counts": COUNTS,
}
DECISION = {
    "id": "217",
    "box_id": 7,
    "frame": "a",
    "frame_id": 1,
    "class": "car",
    "config": "c0ffee",
    "run": 1,
    "effective_verdict": "kept",
    "verdict": "rejected",
    "reason": "below_threshold",
    "hidden_by": [{"tag": 9, "name": "Vegetation", "percent": 71.0}],
    "review": {"verdict": "keep", "revision": 2, "reviewer": "ada", "comment": None},
    "edges": None,
}
_JOB = {"dataset": "town", "total": 9, "created_at": "2026-01-01T00:00:00Z"}
EXPORT = {**_JOB, "id": 4, "state": "done", "done": 9, "format": "yolo", "options": {}}
RUN = {**_JOB, "id": 21, "state": "running", "done": 3, "kind": "decide"}
RUN |= {"config": "", "activate": False, "changed": 0, "created_by": "ada"}
