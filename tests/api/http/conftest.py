"""A dataset with something for every route that is read, and texts that are HTML."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support import frames as scene
from tests.support.live import Live
from tests.support.sensors import depth_png, experiment_report, street_metres

MARKUP = "<img src=x onerror=alert(1)>"
STREET = "/api/v1/datasets/street"


@pytest.fixture(scope="module")
def path_values(service: Live) -> dict[str, Any]:
    """Stores something for every GET route; gives the values for their paths."""
    with service.admin() as admin:
        wanted = {"name": "street", "description": MARKUP}
        admin.post("/api/v1/datasets", json=wanted)
        annotation: dict[str, Any] = scene.annotation()
        marked = {"id": MARKUP, "class": MARKUP, "xyxy": scene.ON_THE_CAR}
        boxes = [*annotation["boxes"], marked]
        files = {
            "annotation": scene.as_json({**annotation, "boxes": boxes}),
            "image": scene.image(),
            "segmentation": scene.segmentation(),
            "depth": depth_png(street_metres(scene.HEIGHT, scene.WIDTH)),
        }
        frame = admin.put(f"{STREET}/frames/a", files=files).json()
        box = frame["decisions"][0]["box_id"]
        answer = {"verdict": "keep", "comment": MARKUP, "seen_revision": 0}
        admin.post(f"/api/v1/boxes/{box}/reviews", json=answer)
        admin.put(f"{STREET}/experiment", json=experiment_report())
        export = admin.post(f"{STREET}/exports", json={"format": "yolo"}).json()["id"]
        admin.get(f"/api/v1/exports/{export}/events")  # returns when the export is done
        link = admin.post(f"/api/v1/exports/{export}/download-links").json()["url"]
        code = admin.post("/api/v1/login-codes").json()["id"]
        # Of a dataset where nothing happens, so that nothing is sent meanwhile.
        admin.post("/api/v1/datasets", json={"name": "quiet"})
        hook = {"url": "http://127.0.0.1:9/", "dataset": "quiet"}
        hook_id = admin.post("/api/v1/hooks", json=hook).json()["id"]
        dataset = admin.get(STREET).json()
    return {
        "code_id": code,
        "hook_id": hook_id,
        "key": link.partition("?key=")[2],
        "dataset": "street",
        "key:any": "a",
        "kind": "image",
        "name:path": "js/main.js",
        "frame_id": frame["frame"]["id"],
        "box_id": box,
        "export_id": export,
        "run_id": dataset["active_run"],
        "digest": dataset["config"],
    }
