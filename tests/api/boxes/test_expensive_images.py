"""Pictures that take much memory or time are refused or limited; others are served."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import cv2
import httpx
import numpy as np
import pytest

from app.http.admission import Admission
from tests.support import frames as scene
from tests.support.api import BASE, Api
from tests.support.archives import frame, lines_of, send, tar_archive
from tests.support.pictures import plain_png
from tests.support.waiting import until

PATIENCE_S = 120
# Of a client that disconnects. It has sent its request before: that may take longer.
LOSING_PATIENCE = httpx.Timeout(PATIENCE_S, read=0.3)
MIB = 1024**2


def road_segmentation(width, height):
    """A segmentation that is all road: a small file, but large when decoded."""
    return plain_png(width, height, scene.color_of("Road"))


def annotation(width, height, *rectangles):
    boxes = [
        {"id": str(number), "class": "car", "xyxy": xyxy}
        for number, xyxy in enumerate(rectangles)
    ]
    camera = {"width": width, "height": height, "fov": 90}
    return {"carla_version": "0.9.15", "camera": camera, "boxes": boxes}


@contextmanager
def serving(serve, **settings):
    service = serve(**settings)
    with service.admin() as client:
        yield service, Api(client)


def decoded(response):
    assert response.status_code == 200, response.text
    return cv2.imdecode(np.frombuffer(response.content, np.uint8), cv2.IMREAD_COLOR)


def put_large(api, name, key, side=6000):
    files = {"segmentation": road_segmentation(side, side)}
    return api.put(name, key, annotation(side, side), **files)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"max_pixel_seconds": 0.05}, "UNGHOST_MAX_PIXEL_SECONDS"),
        ({"max_pixel_memory_bytes": 64 * MIB}, "UNGHOST_MAX_PIXEL_MEMORY_BYTES"),
    ],
)
def test_frame_over_pixel_time_or_memory_limit_is_refused(serve, settings, named):
    with serving(serve, **settings) as (_, api):
        name = api.dataset()

        response = put_large(api, name, "large")

        assert response.status_code == 422, response.text
        problem = response.json()
        assert problem["code"] == "pixels_refused"
        assert "frame large" in problem["detail"]
        assert named in problem["detail"]
        (noted,) = api.json(f"/datasets/{name}/problems")["items"]
        assert noted["key"] == "large"
        ended = "unghost_pixel_processes_ended_total{reason="
        assert ended in api.http.get("/metrics").text


def test_image_over_memory_limit_refuses_its_frame_of_a_batch_or_its_overlay(serve):
    """An overlay that was refused is not tried again."""
    with serving(serve, max_pixel_memory_bytes=64 * MIB, workers=1) as (_, api):
        name = api.dataset()
        large = [
            ("large.json", scene.as_json(annotation(6000, 6000))),
            ("large.segmentation.png", road_segmentation(6000, 6000)),
        ]
        content = tar_archive([*frame("a"), *large, *frame("b")])
        image = plain_png(6000, 6000)

        response = send(api, name, content)
        stored = api.upload_frame(name, "c", annotation(6000, 6000), image=image)
        path = f"/frames/{stored['frame']['id']}/overlay"
        responses = [api.get(path) for _ in range(5)]

        first, refused, last, _ = lines_of(response.text)
        assert [first["status"], last["status"]] == [201, 201]
        assert (refused["key"], refused["status"]) == ("large", 422)
        assert refused["problem"]["code"] == "pixels_refused"
        assert {each.json()["code"] for each in responses} == {"pixels_refused"}

        def processes_ended():
            ended = 'unghost_pixel_processes_ended_total{reason="memory"}'
            lines = api.http.get("/metrics").text.splitlines()
            return [line for line in lines if line.startswith(ended)]

        before, again = processes_ended(), [api.get(path) for _ in range(3)]
        assert {response.status_code for response in again} == {422}
        assert processes_ended() == before


def test_reads_and_answers_do_not_wait_for_frames_being_measured(serve):
    with serving(serve, workers=1) as (_, api):
        name = api.dataset()
        api.upload_frame(name, "small")
        (box, *_) = api.json("/boxes", dataset=name)["items"]
        review = {"verdict": "keep", "seen_revision": 0}
        with ThreadPoolExecutor(16) as senders:
            sent = [
                senders.submit(put_large, api, name, f"large/{number}", 2000)
                for number in range(16)
            ]
            until(lambda: any(request.done() for request in sent))

            api.json("/datasets")
            answered = api.post(f"/boxes/{box['box_id']}/reviews", review)
            ready = api.http.get("/readyz")
            waiting = sum(not request.done() for request in sent)

            assert answered.status_code == 201, answered.text
            # All these threads may have let the event loop be late.
            faults = [fault["code"] for fault in ready.json().get("errors", ())]
            assert ready.is_success or faults == ["event_loop"], ready.text
            assert waiting > 0
        assert {request.result().status_code for request in sent} == {201}


@pytest.mark.parametrize("size", [(2, 9000), (9000, 2), (1, 1), (1, 9000)])
def test_drawings_of_thin_images_are_limited_in_size(api, size):
    name = api.dataset()
    width, height = size
    image = plain_png(width, height, (90, 90, 90))
    files = {"image": image, "segmentation": road_segmentation(width, height)}
    frame = api.upload_frame(
        name, "thin", annotation(width, height, [0, 0, *size]), **files
    )
    number = frame["frame"]["id"]
    (decision,) = frame["decisions"]

    thumbnail = decoded(api.get(f"/frames/{number}/thumbnail"))
    overlay = decoded(api.get(f"/frames/{number}/overlay"))
    crop = decoded(api.get(f"/boxes/{decision['box_id']}/crop", height=2048))

    assert thumbnail.shape[0] <= 768
    assert thumbnail.shape[1] <= 384
    assert overlay.shape == (height, width, 3)
    assert crop.shape[0] <= 2048
    assert crop.shape[1] <= 4096


def test_overlay_is_drawn_once_and_then_cached(serve):
    with serving(serve) as (service, api):
        frame = api.upload_frame(api.dataset(), "kept")
        path = f"/frames/{frame['frame']['id']}/overlay"
        first = api.get(path)

        service.app.state.services.drawers.close()
        again = api.get(path)

        assert again.content == first.content
        assert again.headers["etag"] == first.headers["etag"]


@pytest.mark.long
def test_client_disconnect_cancels_drawing_of_its_overlay(serve):
    with serving(serve, workers=1) as (service, api):
        side = 6000
        image = plain_png(side, side)
        boxes = [[number, 0, number + 50, side] for number in range(0, 5000, 5)]
        stored = api.upload_frame(
            api.dataset(), "a", annotation(side, side, *boxes), image=image
        )
        path = f"{BASE}/frames/{stored['frame']['id']}/overlay"
        left = 'route="/api/v1/frames/{frame_id}/overlay",status="499"'

        with service.admin() as impatient, pytest.raises(httpx.ReadTimeout):
            impatient.get(path, timeout=LOSING_PATIENCE)

        until(lambda: left in api.http.get("/metrics").text)


def test_client_disconnect_cancels_measuring_of_its_frame(serve):
    with serving(serve, workers=1) as (service, api):
        side = 7900  # nearly the largest side that is accepted
        dataset = api.dataset()
        said = scene.as_json(annotation(side, side, [5, 5, 90, 90]))
        parts = {"annotation": said, "segmentation": road_segmentation(side, side)}
        path = f"{BASE}/datasets/{dataset}/frames/large"

        ended = 'unghost_pixel_processes_ended_total{reason="given_up"}'

        def disconnect_and_find_metric():
            # On a busy machine the first requests end before anything is measured.
            with service.admin() as impatient, pytest.raises(httpx.ReadTimeout):
                impatient.put(path, files=parts, timeout=LOSING_PATIENCE)
            return ended in api.http.get("/metrics").text

        until(disconnect_and_find_metric)
        assert api.get(f"/datasets/{dataset}").json()["counts"]["frames"] == 0


@contextmanager
def slow_drawings(service, api, path, count):
    """One viewer asks for a slow picture `count` times at once; yields the requests."""
    made = api.post("/tokens", {"name": "greedy", "role": "viewer"}).json()
    greedy = service.client(Authorization=f"Bearer {made['token']}")
    stopping = service.app.state.services.engine.stopping
    with greedy, ThreadPoolExecutor(count) as viewers:
        requests = [viewers.submit(greedy.get, path) for _ in range(count)]
        try:
            drawings = service.app.state.services.one(Admission).drawings
            until(lambda: drawings.borrowed_tokens)
            yield requests
        finally:
            stopping.set()  # ends the drawings, so that the test need not wait


def test_drawings_of_one_token_do_not_block_others_and_are_cancelled_at_shutdown(
    serve,
):
    side = 6000  # it takes seconds to draw
    boxes = [[number, 0, number + 50, side] for number in range(0, 5800, 2)]
    slow = annotation(side, side, *boxes)
    with serving(serve, workers=1, max_pixel_seconds=PATIENCE_S) as (service, api):
        name = api.dataset()
        small = api.upload_frame(name, "small")["frame"]["id"]
        large = api.upload_frame(name, "slow", slow, image=plain_png(side, side))
        path = f"{BASE}/frames/{large['frame']['id']}/overlay"
        with slow_drawings(service, api, path, 6) as requests:
            thumbnail = api.get(f"/frames/{small}/thumbnail")
            stored = api.put(name, "another")
            overlay = api.get(f"/frames/{small}/overlay")
            drawn = [request for request in requests if request.done()]
        late = api.http.get(path)
        responses = [*(request.result() for request in requests), late]

    assert (thumbnail.status_code, overlay.status_code) == (200, 200)
    assert stored.status_code == 201, stored.text
    assert drawn == []
    assert {response.status_code for response in responses} == {503}
    assert {response.json()["code"] for response in responses} == {"not_ready"}
    assert "the service is stopping" in late.json()["detail"]
