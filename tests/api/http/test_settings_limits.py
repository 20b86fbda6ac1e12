"""Every limit of the settings is enforced, and the refusal names the limit."""

import json

import cv2
import numpy as np
import pytest

from app.settings import Settings
from tests.support import frames as scene
from tests.support.api import Api
from tests.support.archives import TAR, frame, send, tar_archive
from tests.support.live import live
from tests.support.sources import names_of_tests

pytestmark = pytest.mark.long

LIMITS = {
    "max_head_bytes": 2_000,
    "max_body_bytes": 20_000,
    "max_json_bytes": 4_000,
    "max_batch_bytes": 60_000,
    "max_part_bytes": 8_000,
    "max_parts": 4,
    "max_batch_members": 2,
    "max_image_side_px": 100,
    "max_image_pixels": 4_000,
    "max_boxes_per_frame": 3,
    "max_config_bytes": 1_024,
    "max_bulk_boxes": 1,
    "max_folder_bytes": 30_000,
    "max_folder_files": 3,
}
PIXEL_WORK = (
    "tests/api/boxes/test_expensive_images.py::"
    "test_frame_over_pixel_time_or_memory_limit_is_refused"
)
OPEN_BODIES = "tests/api/http/test_open_bodies.py::test_open_body_limit_returns_503"
ANY_BODY = (
    "tests/api/http/test_bodies.py::"
    "test_too_large_content_length_is_refused_before_the_body_is_read"
)
TESTED_ELSEWHERE = {
    "max_body_bytes": ANY_BODY,
    "max_json_bytes": ANY_BODY,
    "max_batch_bytes": ANY_BODY,
    "max_folder_bytes": ANY_BODY,
    "max_pixel_seconds": PIXEL_WORK,
    "max_pixel_memory_bytes": PIXEL_WORK,
    "max_connections": "tests/api/process/test_connections.py::"
    "test_connection_over_the_limit_returns_503_with_retry_after",
    "max_open_body_bytes": OPEN_BODIES,
    "max_open_batches": "tests/api/ingest/test_batches.py::"
    "test_too_many_open_batches_and_frames_over_their_limits_are_refused",
    "max_answers_per_box": "tests/api/review/test_reviews.py::"
    "test_one_person_answers_a_box_only_so_often",
    "max_export_bytes": "tests/api/exports/test_exports.py::"
    "test_oldest_export_makes_place_for_a_new_one",
    "max_folder_seconds": "tests/api/ingest/test_folders.py::"
    "test_folder_over_the_time_limit_is_refused",
    "max_open_runs": "tests/api/runs/test_runs.py::"
    "test_too_many_open_runs_return_429_with_retry_after",
    "max_event_streams": "tests/api/runs/test_run_events.py::"
    "test_event_streams_are_limited_and_freed_on_disconnect",
}
STREET = "/api/v1/datasets/street"
AVENUE = "/api/v1/datasets/avenue/batches"


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    folder = tmp_path_factory.mktemp("limits") / "data"
    with live(folder, **LIMITS) as running:
        with running.admin() as client:
            client.post("/api/v1/datasets", json={"name": "street"})
        yield running


def put(client, **files):
    files = {"annotation": scene.as_json(scene.annotation()), **files}
    return client.put(f"{STREET}/frames/a", files=files)


def image_png(width, height):
    return cv2.imencode(".png", np.zeros((height, width, 3), np.uint8))[1].tobytes()


def boxes(count):
    box = {"class": "car", "xyxy": [0, 0, 9, 9]}
    named = [{**box, "id": str(number)} for number in range(count)]
    return json.dumps({**scene.annotation(), "boxes": named})


REFUSED = {
    "max_head_bytes": (431, lambda c: c.get("/healthz", headers={"X-A": "x" * 2_000})),
    "max_part_bytes": (413, lambda c: put(c, image=b"x" * 9_000)),
    "max_parts": (
        413,
        lambda c: put(c, **dict.fromkeys(("image", "depth", "lidar", "radar"), b"x")),
    ),
    "max_batch_members": (
        413,
        lambda c: send(Api(c), "street", tar_archive(frame("a"))),
    ),
    "max_folder_files": (
        413,
        lambda c: c.post(
            "/api/v1/folders",
            content=tar_archive([(f"seg/{number}.png", b"") for number in range(3)]),
            headers=TAR,
        ),
    ),
    "max_image_side_px": (422, lambda c: put(c, image=image_png(101, 1))),
    "max_image_pixels": (422, lambda c: put(c, image=image_png(100, 41))),
    "max_boxes_per_frame": (422, lambda c: put(c, annotation=boxes(4))),
    "max_config_bytes": (
        413,
        lambda c: c.post(f"{STREET}/configs", json={"x": "x" * 1_024}),
    ),
    "max_bulk_boxes": (
        413,
        lambda c: c.post(
            "/api/v1/reviews/bulk",
            json={"dataset": "street", "box_ids": [1, 2], "verdict": "keep"},
        ),
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_request_over_a_limit_is_refused_and_names_the_limit(admin, name):
    status, ask = REFUSED[name]

    response = ask(admin)

    assert response.status_code == status, response.text
    said = response.json()["detail"].replace(",", "")
    assert str(LIMITS[name]) in said
    assert admin.get(f"{STREET}/frames").json()["items"] == []


def test_frame_at_its_limits_is_stored(serve):
    service = serve(
        **LIMITS | {"max_boxes_per_frame": 2, "max_parts": 3, "max_image_side_px": 64}
    )
    with service.admin() as client:
        client.post("/api/v1/datasets", json={"name": "street"})

        response = put(client, image=scene.image(), segmentation=scene.segmentation())

    assert response.status_code == 201, response.text


def test_every_limit_has_a_test():
    """A new `max_...` of the settings must be added to one of the tables above."""
    limits = {name for name in Settings.model_fields if name.startswith("max_")}

    assert limits == {*REFUSED, *TESTED_ELSEWHERE}
    for test in TESTED_ELSEWHERE.values():
        path, _, name = test.partition("::")
        assert name in names_of_tests(path)
