"""Bad frames: each is refused with a fitting status and message; none is stored."""

import json

import cv2
import numpy as np

from filter_core.segmentation.palettes import FAMILIES
from tests.support import frames as scene
from tests.support.sensors import instance_png

BOX = {"id": "a", "class": "car", "xyxy": scene.ON_THE_CAR}
WIDE = {"width": 65, "height": 48, "fov": 90}
TOO_DEEP = b'{"boxes": [], "x": ' + b"[" * 100_000 + b"]" * 100_000 + b"}"
EMPTY = {"frames": 0, "boxes": 0, "kept": 0, "rejected": 0, "unmeasured": 0}


def encode_image(suffix, pixels):
    return cv2.imencode(suffix, pixels)[1].tobytes()


SMALL = encode_image(".png", np.zeros((9, 9, 3), np.uint8))


def png_with_16_bits():
    pixels = np.zeros((scene.HEIGHT, scene.WIDTH, 3), np.uint16)
    return encode_image(".png", pixels)


def foreign_colors():
    return encode_image(".png", np.full((scene.HEIGHT, scene.WIDTH, 3), 77, np.uint8))


def segmentation_jpeg():
    painted = FAMILIES[scene.FAMILY].paint(scene.tags())
    return encode_image(".jpg", painted[..., ::-1])


def half(data):
    return data[: len(data) // 2]


def assert_nothing_stored(api, dataset):
    described = api.json(f"/datasets/{dataset}")
    counts = described["counts"]
    assert {name: counts[name] for name in EMPTY} == EMPTY
    assert described["thumbnail_frame_id"] is None
    assert api.json(f"/datasets/{dataset}/frames")["items"] == []
    assert api.boxes(dataset) == []


INVALID_ANNOTATIONS = (
    (b"{", "bad_annotation", "JSON"),
    (TOO_DEEP, "bad_annotation", ""),
    (scene.annotation_of({**BOX, "xyxy": [0, 0, "9", 9]}), "bad_annotation", '"9"'),
    (scene.annotation_of(BOX, note={"\ud800": "\ud800"}), "bad_annotation", "note"),
    (scene.annotation_of(BOX, camera=WIDE), "image_size_mismatch", "65"),
)


def test_invalid_annotation_is_refused_and_nothing_is_stored(api):
    dataset = api.dataset()
    for sent, code, words in INVALID_ANNOTATIONS:
        response = api.put(dataset, "town/1", sent)

        problem = response.json()
        assert (response.status_code, problem["code"]) == (422, code), problem
        assert words in problem["detail"]
        (noted,) = api.json(f"/datasets/{dataset}/problems")["items"]
        assert (noted["key"], noted["error"]["detail"]) == ("town/1", problem["detail"])
        assert noted["error"]["errors"] in ([], problem["errors"])
    assert_nothing_stored(api, dataset)


INVALID_FILES = (
    ("segmentation", b"", "bad_image", ""),
    ("segmentation", half(scene.segmentation()), "bad_image", ""),
    ("image", half(scene.image()), "bad_image", "image"),
    ("segmentation", png_with_16_bits(), "bad_segmentation", "16"),
    ("segmentation", SMALL, "image_size_mismatch", "9 x 9"),
    ("segmentation", foreign_colors(), "foreign_colors", "%"),
    ("segmentation", segmentation_jpeg(), "lossy_segmentation", "nearest"),
    ("ignore_mask", b"x", "bad_image", "ignore_mask"),
    ("ignore_mask", SMALL, "image_size_mismatch", "ignore_mask"),
    ("lidar", b"x", "bad_lidar", "PLY"),
)


def test_frame_with_an_invalid_file_is_refused(api):
    dataset = api.dataset()
    files = {"image": scene.image(), "segmentation": scene.segmentation()}
    for part, content, code, words in INVALID_FILES:
        response = api.put(dataset, "a", **(files | {part: content}))

        problem = response.json()
        assert (response.status_code, problem["code"]) == (422, code), problem
        assert problem["detail"].startswith("frame a")
        assert words in problem["detail"]
        assert [fault["pointer"] for fault in problem["errors"]] == [f"/{part}"]
        (noted,) = api.json(f"/datasets/{dataset}/problems")["items"]
        assert noted["error"]["errors"] == problem["errors"]
    assert_nothing_stored(api, dataset)
    assert api.put(dataset, "a").status_code == 201


def test_palette_contradiction_names_dataset_and_annotation(api):
    dataset = api.dataset(palette="carla-0.9.10")

    problem = api.put(dataset, "a").json()

    assert problem["code"] == "segmentation_contradiction"
    assert dataset in problem["detail"]
    assert "carla-0.9.10" in problem["detail"]
    assert "carla_version 0.9.15" in problem["detail"]
    assert_nothing_stored(api, dataset)


def test_lossy_segmentation_is_read_on_request_and_marked_lossy(api):
    dataset = api.dataset(lossy_segmentation="nearest")

    stored = api.upload_frame(dataset, "a", segmentation=segmentation_jpeg())

    assert stored["segmentation"]["lossy"] is True
    assert [box["lossy"] for box in stored["decisions"]] == [True, True]
    assert api.verdicts(dataset) == {"real": "kept", "ghost": "rejected"}
    assert api.json(f"/datasets/{dataset}/stats")["lossy"] == 2
    (summary,) = api.json(f"/datasets/{dataset}/frames")["items"]
    assert summary["lossy"] is True


def test_frame_of_unknown_size_is_refused(api):
    dataset = api.dataset()

    response = api.put(dataset, "a", {"boxes": [BOX]}, depth=scene.image())
    instances = instance_png(scene.tags(), np.full_like(scene.tags(), 7))
    sized = api.put(dataset, "b", {"boxes": [BOX]}, instances=instances)

    assert (response.status_code, response.json()["code"]) == (422, "unknown_size")
    assert api.json(f"/datasets/{dataset}")["counts"]["problems"] == 1
    frame = sized.json()["frame"]
    assert (frame["width"], frame["height"]) == (scene.WIDTH, scene.HEIGHT)


def test_boxes_with_huge_coordinates_are_decided_without_error(api):
    far = [
        {"id": "far", "class": "car", "xyxy": [8e8, 8e8, 9e8, 9e8]},
        {"id": "wide", "class": "car", "xywh": [-9e8, -9e8, 8e8, 8e8]},
        {"id": "all", "class": "car", "xyxy": [-9e8, -9e8, 9e8, 9e8]},
        {"id": "empty", "class": "car", "xyxy": [40, 24, 40, 40]},
    ]

    response = api.put(api.dataset(), "a", scene.annotation_of(*far))

    reasons = {box["id"]: box["reason"] for box in response.json()["decisions"]}
    assert reasons == {
        "far": "outside_image",
        "wide": "outside_image",
        "all": "large_below_threshold",
        "empty": "degenerate",
    }


def test_frame_with_numbers_in_another_unit_is_refused(api):
    car = {"id": "A", "class": "car", "xyxyn": [20, 24, 40, 40]}
    right = {"id": "B", "class": "car", "xyxy": scene.ON_THE_CAR}
    inverted = scene.annotation_of({**right, "id": "A", "xyxy": [40, 40, 20, 24]})
    dataset, published = api.dataset(), api.dataset_of_one_frame()
    api.run(published, {"profile": "carlasimu"})

    response = api.put(dataset, "a", scene.annotation_of(right, car))
    as_published = api.put(published, "b", scene.annotation_of(right, car))
    as_it_is = api.put(published, "c", inverted)

    assert (response.status_code, as_published.status_code) == (422, 201)
    (fault,) = response.json()["errors"]
    assert (fault["pointer"], fault["code"]) == ("/boxes/1/xyxyn", "wrong_unit")
    assert 'box 1 (id "A")' in fault["detail"]
    assert "looks like pixels" in fault["detail"]
    assert api.json(f"/datasets/{dataset}")["counts"]["problems"] == 1

    # What was stored is measured again, and may be sent again.
    api.run(published, {"profile": "paper"})
    assert as_it_is.status_code == 201
    assert api.verdicts(published)["A"] == "rejected"
    assert api.put(published, "c", inverted).status_code == 200


def test_frame_refused_repeatedly_is_one_problem(api):
    """Each retry used to count as one more refused frame."""
    dataset = api.dataset()
    for _ in range(3):
        api.put(dataset, "a", {})
    api.put(dataset, "b", {})

    assert api.json(f"/datasets/{dataset}")["counts"]["problems"] == 2
    api.upload_frame(dataset, "a")
    assert [p["key"] for p in api.json(f"/datasets/{dataset}/problems")["items"]] == [
        "b"
    ]


def test_frame_limits_are_those_of_the_settings(start_api):
    limits = {"UNGHOST_MAX_BOXES_PER_FRAME": "2", "UNGHOST_MAX_PART_BYTES": "2000"}
    limits |= {"UNGHOST_MAX_IMAGE_SIDE_PX": "64", "UNGHOST_MAX_PARTS": "3"}
    _, api = start_api(**limits)
    dataset = api.dataset()
    path = f"/api/v1/datasets/{dataset}/frames/a"
    wide = encode_image(".png", np.zeros((1, 65, 3), np.uint8))
    long = json.dumps(scene.annotation_of(note="x" * 3000))
    many = {"annotation": b"{}", **dict.fromkeys(("image", "lidar", "depth"), b"x")}

    boxes = api.put(dataset, "a", scene.annotation_of(BOX, {**BOX, "id": "b"}, {}))
    side = api.put(dataset, "a", scene.annotation_of(), image=wide)
    file = api.put(dataset, "a", long.encode())
    field = api.http.put(path, data={"annotation": long}, files={"image": b"x"})
    parts = api.http.put(path, files=many)

    assert (boxes.status_code, side.status_code) == (422, 422)
    assert "2" in boxes.json()["detail"]
    assert side.json()["code"] == "image_too_large"
    assert (file.status_code, field.status_code) == (413, 413)
    assert (parts.status_code, parts.json()["code"]) == (413, "too_large")
    assert_nothing_stored(api, dataset)
