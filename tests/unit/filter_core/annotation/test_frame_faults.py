"""Each fault of a frame, its camera or its JSON has the right pointer and message."""

import json

import pytest

from filter_core.annotation.frame import AnnotationLimits
from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import AnnotationErrors
from filter_core.values import MAX_FAULTS
from tests.support.annotation_faults import faults_of

POSE = {"x": 0, "y": 0, "z": 2.4}
CAMERA = {"width": 1280, "height": 720, "fov": 90, "transform": POSE}
K = [[640, 0, 640], [0, 640, 360], [0, 0, 1]]
NAN, INF = float("nan"), float("inf")
MANY_VALUES = b"[" + b"1," * 1_000_000 + b"1]"


@pytest.mark.parametrize(
    ("raw", "pointer", "code", "words"),
    [
        ({}, "/boxes", "missing_boxes",
         "boxes: expected a list of boxes, found nothing"),
        ({"boxes": {}}, "/boxes", "missing_boxes",
         "boxes: expected a list of boxes, found an object"),
        ({"boxes": [7]}, "/boxes/0", "not_an_object",
         'box 0 (id "0"): expected an object, found 7'),
        ([], "", "not_an_object", "annotation: expected an object, found a list of 0"),
        ({"boxes": [], "map": 10}, "/map", "not_a_text",
         "map: expected a text, found 10"),
        ({"boxes": [], "weather": {"fog": [INF]}}, "/weather/fog/0", "not_finite",
         "weather.fog[0]: expected a finite number, found Infinity"),
        ({"boxes": [], "captured_at": "yesterday"}, "/captured_at", "bad_time",
         "captured_at: expected an RFC 3339 time such as 2026-01-01T00:00:00Z, "
         'found "yesterday"'),
        ({"boxes": [], "sensors": {"lidar": 7}}, "/sensors/lidar", "not_an_object",
         "sensors.lidar: expected an object, found 7"),
        ({"boxes": [], "a/b~c": {"d": NAN}}, "/a~1b~0c/d", "not_finite",
         "a/b~c.d: expected a finite number, found NaN"),
        ({"boxes": [], "kept": {"a\0": 1}}, "/kept", "bad_key",
         "kept: expected keys that are texts without control characters, "
         r"found the text 'a\x00'"),
    ],
)  # fmt: skip
def test_invalid_frame_reports_pointer_code_and_message(raw, pointer, code, words):
    assert faults_of(raw) == [(pointer, code, words)]


@pytest.mark.parametrize(
    ("camera", "pointer", "code", "words"),
    [
        (7, "", "not_an_object", ": expected an object, found 7"),
        ({"height": 720}, "/width", "missing",
         ".width: expected a number of pixels, found nothing"),
        ({**CAMERA, "width": 0}, "/width", "bad_size",
         ".width: expected a whole number of pixels from 1, found 0"),
        ({**CAMERA, "height": 0.5}, "/height", "bad_size",
         ".height: expected a whole number of pixels from 1, found 0.5"),
        ({**CAMERA, "fov": 180}, "/fov", "bad_camera",
         ".fov: expected degrees between 0 and 180, found 180.0"),
        ({**CAMERA, "fov": "90"}, "/fov", "not_a_number",
         '.fov: expected a number, found "90"'),
        ({**CAMERA, "intrinsic": K}, "", "contradiction",
         ": expected fov or intrinsic, found both"),
        ({**CAMERA, "transform": {"x": 1}}, "/transform/y", "missing",
         ".transform.y: expected a number, found nothing"),
        ({"width": 9, "height": 9, "intrinsic": [[1, 0, 0], [0, 1, 0]]}, "/intrinsic",
         "wrong_length",
         ".intrinsic: expected a list of 3 rows of 3 numbers, found a list of 2"),
    ],
)  # fmt: skip
def test_invalid_camera_reports_pointer_code_and_message(camera, pointer, code, words):
    faults = faults_of({"boxes": [], "camera": camera})

    assert faults[0] == (f"/camera{pointer}", code, f"camera{words}")


@pytest.mark.parametrize(
    ("camera", "detail"),
    [(None, "nothing"), ({"width": 9, "height": 9, "fov": 90}, "fov, height, width")],
)
def test_3d_box_without_a_complete_camera_is_a_fault(camera, detail):
    box = {"id": "9", "class": "car", "box3d": {"extent": [1, 1, 1]}}

    faults = faults_of({"boxes": [box], "camera": camera})

    words = (
        "camera: expected width, height, fov and transform (or intrinsic and "
        f'world_to_camera) because box 0 (id "9") is 3D, found {detail}'
    )
    assert faults == [("/camera", "missing_camera", words)]


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        (b"{", "not_json", "a fault at line 1, column 2: Expecting property name"),
        (b"", "not_json", "a fault at line 1, column 1: Expecting value"),
        (b'{"map": "\xff"}', "not_json", "other bytes at offset 9"),
        (b"[" + b"1" * 5000 + b"]", "not_json", "a number of more than 100 characters"),
        (b"[" * 200_000, "json_too_large", "JSON that is nested deeper than 64 levels"),
        (MANY_VALUES, "json_too_large", "JSON of more than 500000 values"),
    ],
)
def test_invalid_or_too_large_json_is_one_fault(text, kind, words):
    ((pointer, code, detail),) = faults_of(text)

    assert (pointer, code) == ("", kind)
    assert detail.startswith(f"annotation: expected JSON in UTF-8, found {words}")


def test_nan_and_infinity_in_json_are_faults_with_their_pointers():
    text = b"""{"boxes": [{"id": "a", "class": "car", "speed": NaN,
                "xyxy": [NaN, -Infinity, 1e999, 4]}], "weather": {"fog": Infinity}}"""

    of_box = [f"/boxes/0/{key}" for key in ("xyxy/0", "xyxy/1", "xyxy/2", "speed")]
    expected = [(pointer, "not_finite") for pointer in (*of_box, "/weather/fog")]
    assert [fault[:2] for fault in faults_of(text)] == expected


def test_duplicate_json_key_is_a_fault():
    text = """{"map": "a", "map": "b", "boxes": [
        {"id": "a", "class": "car", "class": "van", "xyxy": [1, 2, 3, 4]}]}"""

    once = "expected a key that occurs once, found"
    of_box = f'box 0 (id "a"), class: {once} "class" twice'
    assert faults_of(text) == [
        ("/map", "duplicate_key", f'map: {once} "map" twice'),
        ("/boxes/0/class", "duplicate_key", of_box),
    ]


def test_all_faults_are_reported_at_once_with_the_frame_key():
    second = {"id": "b", "class": "car", "xywh": ["1", "2", 3, 4], "distance": -1}
    boxes = [{"id": "a", "xyxy": [1, 2, 3]}, second]

    faults = faults_of(json.dumps({"map": 1, "boxes": boxes}), frame="town/01")

    of_boxes = ("0/class", "0/xyxy", "1/xywh/0", "1/xywh/1", "1/distance")
    pointers = ["/map", *(f"/boxes/{pointer}" for pointer in of_boxes)]
    assert [fault[0] for fault in faults] == pointers
    assert faults[3][2] == (
        'frame town/01, box 1 (id "b"), xywh[0]: expected a number, found "1"'
    )


KEPT_NUMBERS = b'{"boxes": [], "kept": [' + b"1e999," * 300_000 + b"1]}"
ONE_KEY = b'{"boxes": [], ' + b'"map": "", ' * 50_000 + b'"a": 1, "map": "a"}'
KEY_PAIRS = b", ".join(b'"%d": 1, "%d": 2' % (key, key) for key in range(50_000))


@pytest.mark.parametrize(
    ("text", "count"),
    [
        pytest.param(KEPT_NUMBERS, 300_000, id="numbers that are kept"),
        pytest.param(b'{"boxes": [' + b"1," * 9_999 + b"1]}", 10_000, id="boxes"),
        pytest.param(ONE_KEY, 1, id="one key again and again"),
        pytest.param(b'{"boxes": [], ' + KEY_PAIRS + b"}", 50_000, id="keys twice"),
    ],
)
def test_first_faults_are_reported_and_the_rest_counted(text, count):
    with pytest.raises(AnnotationErrors) as refused:
        parse_annotation(text)

    assert len(refused.value.errors) == min(count, MAX_FAULTS)
    assert refused.value.count == count
    if count > 1:
        assert refused.value.detail.endswith(f" (and {count - 1} more)")


def test_deep_keys_many_boxes_and_long_keys_of_a_fault_are_limited():
    deep: object = 1
    for _ in range(40):
        deep = [deep]
    ((pointer, code, _),) = faults_of({"boxes": [], "kept": deep})
    assert (pointer, code) == ("/kept" + "/0" * 32, "nested_too_deeply")

    faults = faults_of({"boxes": [{}] * 3}, limits=AnnotationLimits(max_boxes=2))
    words = "boxes: expected at most 2 boxes, found 3"
    assert faults == [("/boxes", "too_many_boxes", words)]

    # There may be a hundred faults below each key.
    key, short = "k" * 100_000, "k" * 80 + "…"
    ((pointer, _, detail),) = faults_of(json.dumps({"boxes": [], key: {key: [NAN]}}))
    assert pointer == f"/{short}/{short}/0"
    assert detail == f"{short}.{short}[0]: expected a finite number, found NaN"
