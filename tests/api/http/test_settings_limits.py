"""Every limit of the settings is enforced, and the refusal names the limit."""

from __future__ import annotations

import json
import threading
from contextlib import ExitStack, contextmanager

import cv2
import numpy as np
import pytest

from app.settings import Settings
from tests.support import frames as scene
from tests.support.archives import frame, tar_archive
from tests.support.live import block_jobs, live
from tests.support.sources import names_of_tests
from tests.support.waiting import until

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
    "max_open_jobs_per_token": 2,
    "max_event_streams_per_token": 1,
    "max_open_batches_per_token": 1,
    "max_folder_bytes": 30_000,
    "max_folder_files": 3,
}
PIXEL_WORK = (
    "tests/api/boxes/test_expensive_images.py::"
    "test_frame_over_pixel_time_or_memory_limit_is_refused"
)
OPEN_BODIES = (
    "tests/api/http/test_open_bodies.py::test_open_body_limits_return_429_and_503"
)
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
    "max_open_body_bytes_per_token": OPEN_BODIES,
    "max_open_batches": "tests/api/ingest/test_batches.py::"
    "test_too_many_open_batches_return_429",
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
TAR = {"Content-Type": "application/x-tar"}
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
    found = [{**box, "id": str(number)} for number in range(count)]
    return json.dumps({**scene.annotation(), "boxes": found})


REFUSED = {
    "max_head_bytes": (431, lambda c: c.get("/healthz", headers={"X-A": "x" * 2_000})),
    "max_part_bytes": (413, lambda c: put(c, image=b"x" * 9_000)),
    "max_parts": (
        413,
        lambda c: put(c, **dict.fromkeys(("image", "depth", "lidar", "radar"), b"x")),
    ),
    "max_batch_members": (
        413,
        lambda c: c.post(
            f"{STREET}/batches", content=tar_archive(frame("a")), headers=TAR
        ),
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

    answer = ask(admin)

    assert answer.status_code == status, answer.text
    said = answer.json()["detail"].replace(",", "")
    assert str(LIMITS[name]) in said
    assert admin.get(f"{STREET}/frames").json()["items"] == []


def test_frame_at_its_limits_is_stored(serve):
    service = serve(
        **LIMITS | {"max_boxes_per_frame": 2, "max_parts": 3, "max_image_side_px": 64},
    )
    with service.admin() as client:
        client.post("/api/v1/datasets", json={"name": "street"})

        answer = put(client, image=scene.image(), segmentation=scene.segmentation())

    assert answer.status_code == 201, answer.text


@pytest.fixture
def blocked_engine(service):
    with block_jobs(service.app.state.services.engine):
        yield


def reviewer_client(service, admin, name):
    token = admin.post("/api/v1/tokens", json={"name": name}).json()["token"]
    return service.client(Authorization=f"Bearer {token}")


def test_open_jobs_are_limited_per_token(service, admin, blocked_engine):
    digest = admin.get(f"{STREET}/config").json()["digest"]
    asks = [
        (f"{STREET}/runs", {"config": digest}),
        (f"{STREET}/exports", {"format": "yolo"}),
        (f"{STREET}/runs", {"config": digest}),
        (f"{STREET}/exports", {"format": "yolo"}),
        (f"{STREET}/evaluations", None),
    ]
    with reviewer_client(service, admin, "greedy") as greedy:
        answers = [greedy.post(path, json=sent) for path, sent in asks]
        late = answers[2]
        path, body = asks[0]
        other = admin.post(path, json=body)
        greedy.post(f"{answers[0].headers['location']}/cancel")
        again = greedy.post(path, json=body)

    assert [one.status_code for one in answers] == [202, 202, 429, 429, 429]
    assert (late.json()["code"], late.headers["retry-after"]) == ("too_many_jobs", "10")
    assert (other.status_code, again.status_code) == (202, 202)


def test_event_streams_are_limited_per_token(service, admin, blocked_engine):
    digest = admin.get(f"{STREET}/config").json()["digest"]
    run = admin.post(f"{STREET}/runs", json={"config": digest})
    events = f"{run.headers['location']}/events"
    with (
        reviewer_client(service, admin, "watcher") as watcher,
        ExitStack() as open_streams,
    ):
        first = open_streams.enter_context(watcher.stream("GET", events))
        # Kept in a name: the response closes when its last reader is deleted.
        lines = first.iter_lines()
        assert next(lines) == "retry: 1000"
        refused = watcher.get(events)
        other = open_streams.enter_context(admin.stream("GET", events))

    assert (first.status_code, other.status_code) == (200, 200)
    assert refused.status_code == 429
    assert "1 streams of this token" in refused.json()["detail"]
    assert int(refused.headers["retry-after"]) >= 1


def test_open_batches_are_limited_per_token(service, admin):
    admin.post("/api/v1/datasets", json={"name": "avenue"})
    with (
        reviewer_client(service, admin, "sender") as sender,
        open_upload(sender) as go_on,
    ):
        refused, other = send(sender), send(admin)
        go_on()
    with reviewer_client(service, admin, "patient") as patient:
        again = [send(patient), send(patient)]

    assert refused.status_code == 429
    assert "1 batches of this token" in refused.json()["detail"]
    assert int(refused.headers["retry-after"]) >= 1
    assert [one.status_code for one in (other, *again)] == [200, 200, 200]


def send(client, content=None):
    content = content or tar_archive(frame("a")[:2])
    return client.post(AVENUE, content=content, headers=TAR)


@contextmanager
def open_upload(client):
    """An upload that stays open until the function that is yielded is called."""
    let_go = threading.Event()

    def body():
        yield bytes(512)  # enough bytes to be accepted as an archive
        let_go.wait(120)
        yield bytes(512)

    thread = threading.Thread(target=send, args=(client, body()))

    def is_open():
        assert thread.is_alive()
        return "unghost_batches_open 1" in client.get("/metrics").text

    thread.start()
    try:
        until(is_open)
        yield let_go.set
    finally:
        let_go.set()
        thread.join()


def test_every_limit_has_a_test():
    """A new `max_...` of the settings must be added to one of the tables above."""
    limits = {name for name in Settings.model_fields if name.startswith("max_")}
    here = {
        *("max_open_jobs_per_token", "max_event_streams_per_token"),
        "max_open_batches_per_token",
    }

    assert limits == {*REFUSED, *TESTED_ELSEWHERE, *here}
    for test in TESTED_ELSEWHERE.values():
        path, _, name = test.partition("::")
        assert name in names_of_tests(path)
