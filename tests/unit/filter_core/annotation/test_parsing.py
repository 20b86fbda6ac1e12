"""Parsing valid annotations: accepted forms, defaults, and keys that are kept."""

import json

import numpy as np
import pytest

from filter_core.annotation.frame import FORMS_3D
from filter_core.annotation.parsing import parse_annotation
from filter_core.geometry.pose import Transform

POSE = {"x": 0, "y": 0, "z": 2.4, "pitch": 0, "yaw": 0, "roll": 0}
CAMERA = {"width": 1280, "height": 720, "fov": 90, "transform": POSE}
CORNERS = [[10 + x, y, z] for x in (0, 4) for y in (-1, 1) for z in (0, 1.5)]


def car(**keys):
    return {"class": "car", "xyxy": [83, 410, 466, 640], **keys}


def frame(*boxes, **keys):
    return {"boxes": list(boxes), **keys}


def parse_one_box(**keys):
    (box,) = parse_annotation(frame(car(**keys))).boxes
    return box


def geometry(form, values):
    box = {"class": "car", form: values}
    (read,) = parse_annotation(frame(box, camera=CAMERA)).boxes
    return read.form, read.values


EXAMPLE = frame(
    {"id": "217", "class": "car", "xyxy": [83, 410, 466, 640], "distance": 12.5},
    {"id": "218", "type_id": "vehicle.x", "base_type": "van", "xywh": [10, 20, 30, 40]},
    {"id": "219", "class": "van", "cxcywhn": [0.5] * 4, "instance_id": 4711},
    {"id": "220", "class": "walker", "vertices": CORNERS},
    carla_version="0.9.15",
    captured_at="2026-01-01T00:00:00Z",
    map="Town10HD",
    weather={"fog_density": 2.0},
    camera=CAMERA,
)


def test_example_annotation_is_parsed():
    read = parse_annotation(EXAMPLE)

    assert (read.carla_version, read.map) == ("0.9.15", "Town10HD")
    assert read.captured_at == EXAMPLE["captured_at"]
    assert read.raw == EXAMPLE
    assert read.camera_wh == (1280, 720)
    boxes = read.boxes
    assert [box.id for box in boxes] == ["217", "218", "219", "220"]
    assert [box.class_name for box in boxes] == ["car", None, "van", "walker"]
    assert [box.distance for box in boxes] == [12.5, None, None, None]
    assert (boxes[1].type_id, boxes[1].base_type) == ("vehicle.x", "van")
    assert boxes[2].instance_id == 4711
    assert [box.form in FORMS_3D for box in boxes] == [False, False, False, True]


def test_bytes_text_and_mapping_are_parsed_equally():
    raw = frame(car(id="ä"), carla_version="0.9.15")
    text = json.dumps(raw, ensure_ascii=False)

    by_mapping = parse_annotation(raw)

    assert parse_annotation(text) == by_mapping
    assert parse_annotation(text.encode()) == by_mapping
    assert parse_annotation(b"\xef\xbb\xbf" + text.encode()) == by_mapping


@pytest.mark.parametrize(
    ("box_id", "expected"),
    [
        ("217", "217"),
        (217, "217"),
        (-1, "-1"),
        (2**63 - 1, str(2**63 - 1)),
        (2**64 - 1, str(2**64 - 1)),
        (-(2**63) + 1, str(-(2**63) + 1)),
        (None, "0"),
    ],
)
def test_box_id_becomes_text_and_null_id_becomes_the_index(box_id, expected):
    assert parse_one_box(id=box_id).id == expected


def test_null_values_are_missing_and_unknown_keys_are_kept():
    keys = ("id", "type_id", "distance", "instance_id", "extra")
    box = parse_one_box(**dict.fromkeys(keys))

    assert (box.id, box.type_id) == ("0", None)
    assert (box.distance, box.instance_id) == (None, None)
    everything = ("camera", "map", "weather", "sensors", "captured_at", "carla_version")
    read = parse_annotation(frame(car(), **dict.fromkeys(everything)))
    assert (read.camera, read.map, read.sensors) == (None, None, {})
    given_box = car(occluded=0.4, extra={"note": "parked"}, tags=["a", None])
    raw = frame(given_box, extra={"a": 1}, scenario={"n": 7})

    read = parse_annotation(raw)

    assert read.raw == raw
    assert read.boxes[0].raw == given_box


@pytest.mark.parametrize(
    ("xyxy", "values"),
    [
        ([-0.0, 0, 1e9, -1e9], (0.0, 0.0, 1e9, -1e9)),
        (np.array([1, 2, 3, 4], dtype=np.float32), (1, 2, 3, 4)),
        ((1, np.int64(2), 3, 4), (1, 2, 3, 4)),
    ],
)
def test_numbers_may_be_of_python_or_numpy(xyxy, values):
    assert parse_one_box(xyxy=xyxy).values == values
    assert parse_one_box(distance=-0.0).distance == 0
    assert parse_one_box(distance=np.float32(2)).distance == 2


def test_vertices_may_be_lists_objects_or_arrays():
    objects = [dict(zip("xyz", corner, strict=True)) for corner in CORNERS]
    flat = tuple(float(number) for corner in CORNERS for number in corner)

    assert geometry("vertices", CORNERS) == ("vertices", flat)
    assert geometry("vertices", objects) == ("vertices", flat)
    assert geometry("vertices", np.array(CORNERS, dtype=float)) == ("vertices", flat)


@pytest.mark.parametrize(
    ("box3d", "numbers"),
    [
        ({"transform": {"x": 1, "y": 2, "z": 3, "pitch": 4, "yaw": 5, "roll": 6},
          "location": {"x": 7, "y": 8, "z": 9}, "extent": {"x": 10, "y": 11, "z": 12},
          "rotation": {"pitch": 13, "yaw": 14, "roll": 15}}, range(1, 16)),
        ({"transform": {"location": [1, 2, 3], "rotation": [4, 5, 6]},
          "location": [7, 8, 9], "extent": [10, 11, 12], "rotation": [13, 14, 15]},
         range(1, 16)),
        ({"location": [7, 8, 9], "extent": [1, 2, 0]},
         (0,) * 6 + (7, 8, 9, 1, 2, 0) + (0,) * 3),
    ],
)  # fmt: skip
def test_box3d_in_carla_notation_is_parsed_to_15_numbers(box3d, numbers):
    assert geometry("box3d", box3d) == ("box3d", tuple(numbers))


@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        {**CAMERA, "transform": {"location": [0, 0, 2.4]}},
        {"width": 1280.0, "height": 720,
         "intrinsic": [[640, 0, 640], [0, 640, 360], [0, 0, 1]],
         "world_to_camera": Transform((0, 0, 2.4)).inverse_matrix.tolist()},
        {"width": 1280, "height": 720, "fov": 90,
         "world_to_camera": Transform((0, 0, 2.4)).inverse_matrix.tolist()},
    ],
)  # fmt: skip
def test_equivalent_camera_notations_are_parsed_equally(camera):
    read = parse_annotation(frame(camera=camera)).camera

    assert read is not None
    np.testing.assert_allclose(read.position, [0, 0, 2.4])
    np.testing.assert_allclose(read.intrinsic[0], [640, 0, 640])


def test_camera_may_lack_a_pose_and_sensors_have_their_own():
    lidar = {"transform": POSE, "channels": 64}
    camera = {"width": 1280, "height": 720}
    sensors = {"lidar": lidar, "radar": {}}

    read = parse_annotation(frame(car(), camera=camera, sensors=sensors))

    assert (read.camera, read.camera_wh) == (None, (1280, 720))
    assert read.sensors == {"lidar": Transform((0, 0, 2.4)), "radar": None}


@pytest.mark.parametrize("end", ["Z", "z", ".5Z", ".123456789+02:00"])
def test_rfc_3339_times_are_kept_as_given(end):
    time = f"2026-01-01T00:00:00{end}"

    assert parse_annotation(frame(captured_at=time)).captured_at == time
