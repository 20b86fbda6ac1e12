"""Boxes like another one, the same object in other frames, and its depths."""

import cv2
import numpy as np
import pytest

from tests.support import frames as scene
from tests.support import sensors
from tests.support.api import BASE, BY_TAGS


def get(api, path):
    response = api.http.get(f"{BASE}{path}")
    assert response.status_code == 200, response.text
    return response.json()


def box(name, xyxy=scene.IN_THE_SKY, **more):
    return {"id": name, "class": "car", "xyxy": xyxy, **more}


def test_boxes_alike_share_class_reason_and_band_and_have_no_answer(api):
    boxes = [
        box("asked", distance=10),
        box("same", [3, 2, 13, 12], distance=40),
        box("answered", distance=10),
        box("farther", distance=60),
        box("kept", scene.ON_THE_CAR, distance=10),
        {**box("truck", distance=10), "class": "truck"},
    ]
    dataset = api.dataset_of_one_frame(scene.annotation_of(*boxes), config=BY_TAGS)
    ids = {box["id"]: box["box_id"] for box in api.boxes(dataset)}
    api.post(
        f"/boxes/{ids['answered']}/reviews", {"verdict": "reject", "seen_revision": 0}
    )

    alike = get(api, f"/boxes/{ids['asked']}/alike")

    assert [box["id"] for box in alike["items"]] == ["same"]
    assert (alike["total"], alike["probable"]) == (1, 1)


def test_boxes_alike_with_other_numbers_come_after_those_probably_the_same(api):
    x0, y0, x1, y1 = scene.ON_THE_CAR
    boxes = [
        box("asked", [x0, y0, x1, y1]),
        box("half", [x0, y0 - 16, x1, y1]),
        box("most", [x0, y0 - 1, x1, y1]),
    ]
    dataset = api.dataset_of_one_frame(scene.annotation_of(*boxes), config=BY_TAGS)
    ids = {box["id"]: box["box_id"] for box in api.boxes(dataset)}

    alike = get(api, f"/boxes/{ids['asked']}/alike")

    assert [box["id"] for box in alike["items"]] == ["most", "half"]
    assert (alike["total"], alike["probable"]) == (2, 1)


@pytest.fixture(scope="module")
def drive(api):
    """Eight frames of one recording in which car 7 comes nearer; one of another."""
    dataset = api.dataset()
    for number in range(8):
        # In the last frame, another object has its id.
        distance = 200 if number == 7 else 40 - number
        boxes = [box("7", scene.ON_THE_CAR, distance=distance)] if number != 4 else []
        annotation = scene.annotation_of(*boxes)
        api.upload_frame(dataset, f"run/{number:03}", annotation=annotation)
    annotation = scene.annotation_of(box("7", scene.ON_THE_CAR, distance=33))
    api.upload_frame(dataset, "sun/000", annotation=annotation)
    return dataset


def test_track_has_the_object_in_five_frames_each_way_of_its_recording(api, drive):
    frame = get(api, f"/datasets/{drive}/frames/run/006")

    track = get(api, f"/boxes/{frame['boxes'][0]['box_id']}/track")

    # Frame 4 does not have it, frame 7 has another object, and "sun" is another drive.
    places = [(box["offset"], box["frame"]) for box in track["items"]]
    assert places == [(number - 6, f"run/{number:03}") for number in (1, 2, 3, 5, 6)]


@pytest.fixture(scope="module")
def measured(api):
    """A frame with depth and instances of a near car, and a car hidden behind it."""
    dataset = api.dataset()
    files = {**sensors.sensors(), "image": sensors.files()["segmentation"]}
    api.upload_frame(dataset, "a", annotation=sensors.ANNOTATION, **files)
    return {box["id"]: box["box_id"] for box in api.boxes(dataset)}


def test_slice_has_the_boxes_interval_and_the_depths_of_its_pixels(api, measured):
    profile = get(api, f"/boxes/{measured['218']}/slice")

    assert (profile["near"], profile["far"]) == (sensors.FAR - 2, sensors.FAR + 2)
    assert profile["median"] == pytest.approx(sensors.NEAR - 2, abs=0.1)
    assert sum(band["percent"] for band in profile["bands"]) == pytest.approx(
        100, abs=1
    )
    assert all(band["near"] < band["far"] for band in profile["bands"])


def test_slice_without_a_depth_image_is_not_found(api):
    dataset = api.dataset_of_one_frame(scene.annotation_of(box("a")))
    (only,) = api.boxes(dataset)

    response = api.http.get(f"{BASE}/boxes/{only['box_id']}/slice")

    assert (response.status_code, response.json()["code"]) == (404, "not_found")


@pytest.mark.parametrize("layer", ["depth", "instances"])
def test_crop_shows_the_layer_and_at_least_so_much_of_the_frame(api, measured, layer):
    path = f"{BASE}/boxes/{measured['218']}/crop?pad=0&least=60&height=60"

    response = api.http.get(f"{path}&layer={layer}")

    assert response.status_code == 200, response.text
    content = np.frombuffer(response.content, np.uint8)
    picture = np.asarray(cv2.imdecode(content, cv2.IMREAD_COLOR))
    assert picture.shape == (60, 60, 3)
    corner, middle = picture[2, 2].astype(int), picture[30, 30].astype(int)
    assert np.abs(corner - middle).max() > 40
