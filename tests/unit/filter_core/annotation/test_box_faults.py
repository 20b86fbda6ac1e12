"""Each fault of a box is reported with the right pointer, code and message."""

import pytest

from tests.support.annotation_faults import faults_of

POSE = {"x": 0, "y": 0, "z": 2.4}
CAMERA = {"width": 1280, "height": 720, "fov": 90, "transform": POSE}
FORMS = "xyxy, xyxyn, xywh, cxcywh, cxcywhn, vertices, box3d"
NAN, INF = float("nan"), float("inf")


def box_faults(box, **frame):
    """The faults of a box that is the second of its frame, with id 217."""
    first = {"id": "a", "class": "car", "xyxy": [1, 2, 3, 4]}
    second = {"id": "217", "class": "car", **box}
    return [
        (
            pointer.removeprefix("/boxes/1"),
            code,
            detail.removeprefix('box 1 (id "217")'),
        )
        for pointer, code, detail in faults_of({"boxes": [first, second], **frame})
    ]


@pytest.mark.parametrize(
    ("xyxy", "pointer", "code", "words"),
    [
        ("1,2", "", "not_a_list", ': expected a list of 4 numbers, found "1,2"'),
        (None, "", "not_a_list", ": expected a list of 4 numbers, found null"),
        ({"x": 1}, "", "not_a_list", ": expected a list of 4 numbers, found an object"),
        (7, "", "not_a_list", ": expected a list of 4 numbers, found 7"),
        ("9" * 500, "", "not_a_list",
         ': expected a list of 4 numbers, found "' + "9" * 60 + '…"'),
        ([], "", "wrong_length", ": expected a list of 4 numbers, found a list of 0"),
        ([1, 2, 3], "", "wrong_length",
         ": expected a list of 4 numbers, found a list of 3"),
        ([1, "2", 3, 4], "/1", "not_a_number", '[1]: expected a number, found "2"'),
        ([1, 2, True, 4], "/2", "not_a_number", "[2]: expected a number, found true"),
        ([None, 2, 3, 4], "/0", "not_a_number", "[0]: expected a number, found null"),
        ([1, 2, 3, []], "/3", "not_a_number",
         "[3]: expected a number, found a list of 0"),
        ([NAN, 2, 3, 4], "/0", "not_finite",
         "[0]: expected a finite number, found NaN"),
        ([1, 2, INF, 4], "/2", "not_finite",
         "[2]: expected a finite number, found Infinity"),
        ([1, -INF, 3, 4], "/1", "not_finite",
         "[1]: expected a finite number, found -Infinity"),
        ([1, 2, 3, 1e308], "/3", "number_too_large",
         "[3]: expected a number between -1e9 and 1e9, found 1e+308"),
        ([1, 2, 3, 10**400], "/3", "number_too_large",
         "[3]: expected a number between -1e9 and 1e9, found an integer "
         "of 1329 bits"),
    ],
)  # fmt: skip
def test_invalid_rectangle_reports_pointer_code_and_message(xyxy, pointer, code, words):
    assert box_faults({"xyxy": xyxy}) == [(f"/xyxy{pointer}", code, f", xyxy{words}")]


@pytest.mark.parametrize(
    ("box", "pointer", "code", "words"),
    [
        ({}, "", "no_geometry", f": expected exactly one of {FORMS}, found none"),
        ({"xyxy": [1, 2, 3, 4], "xywh": [1, 2, 3, 4]}, "", "several_geometries",
         f": expected exactly one of {FORMS}, found xyxy and xywh"),
        ({"vertices": [[1, 2, 3]] * 7}, "/vertices", "wrong_length",
         ", vertices: expected a list of 8 points, found a list of 7"),
        ({"vertices": [[1, 2, 3]] * 7 + [[1, 2]]}, "/vertices/7", "wrong_length",
         ", vertices[7]: expected a list of 3 numbers, found a list of 2"),
        ({"vertices": [[1, 2, 3]] * 7 + [[1, 2, "3"]]}, "/vertices/7/2",
         "not_a_number", ', vertices[7][2]: expected a number, found "3"'),
        ({"vertices": [[1, 2, 3]] * 7 + [{"x": 1, "y": 2}]}, "/vertices/7/z",
         "missing", ", vertices[7].z: expected a number, found nothing"),
        ({"vertices": [[1, 2, 3]] * 7 + ["c"]}, "/vertices/7", "not_a_vector",
         ', vertices[7]: expected {x, y, z} or a list of 3 numbers, found "c"'),
        ({"box3d": [1, 2]}, "/box3d", "not_an_object",
         ", box3d: expected an object, found a list of 2"),
        ({"box3d": {"location": [1, 2, 3]}}, "/box3d/extent", "missing",
         ", box3d.extent: expected half sizes {x, y, z}, found nothing"),
        ({"box3d": {"extent": {"x": 1, "y": 1}}}, "/box3d/extent/z", "missing",
         ", box3d.extent.z: expected a number, found nothing"),
        ({"box3d": {"extent": [1, 2, 3], "extend": 1}}, "/box3d/extend", "unknown_key",
         ", box3d.extend: expected only transform, location, extent, rotation, "
         "found 1"),
        ({"box3d": {"extent": [1, 2, 3], "rotation": {"yaw": NAN}}},
         "/box3d/rotation/yaw", "not_finite",
         ", box3d.rotation.yaw: expected a finite number, found NaN"),
    ],
)  # fmt: skip
def test_missing_several_or_invalid_geometries_are_reported(box, pointer, code, words):
    assert box_faults(box, camera=CAMERA) == [(pointer, code, words)]


@pytest.mark.parametrize(
    ("keys", "code", "words"),
    [
        ({"distance": -1}, "negative_distance", "expected metres from 0, found -1"),
        ({"distance": "9"}, "not_a_number", 'expected a number, found "9"'),
        ({"distance": True}, "not_a_number", "expected a number, found true"),
        ({"distance": NAN}, "not_finite", "expected a finite number, found NaN"),
        ({"instance_id": 1.5}, "not_an_integer", "expected an integer, found 1.5"),
        ({"instance_id": True}, "not_an_integer", "expected an integer, found true"),
        ({"instance_id": -1}, "out_of_range",
         "expected an integer from 0 to 2^63 - 1, found -1"),
        ({"class": None}, "missing_class",
         "expected a class or a type_id, found neither"),
        ({"class": 7}, "not_a_text", "expected a text, found 7"),
        ({"class": " "}, "empty", 'expected a text that is not empty, found " "'),
        ({"class": "x" * 257}, "text_too_long",
         "expected at most 256 characters, found 257 characters"),
        ({"type_id": "a\nb"}, "control_character",
         r"expected a text without control characters, found the text 'a\nb'"),
        ({"base_type": "\ud800"}, "control_character",
         r"expected a text without control characters, found the text '\ud800'"),
        ({"extra": [1]}, "not_an_object", "expected an object, found a list of 1"),
        ({"speed": NAN}, "not_finite", "expected a finite number, found NaN"),
        ({"speed": {1, 2}}, "not_json", "expected a JSON value, found set"),
        ({"note": "a\0b"}, "control_character",
         "expected a text without NUL and halves of surrogate pairs, "
         r"found the text 'a\x00b'"),
    ],
)  # fmt: skip
def test_invalid_box_field_is_reported_with_its_pointer(keys, code, words):
    (field,) = keys

    faults = box_faults({"xyxy": [1, 2, 3, 4], **keys})

    assert faults == [(f"/{field}", code, f", {field}: {words}")]


@pytest.mark.parametrize(
    ("value", "label", "code", "words"),
    [
        ("", '""', "empty", 'expected a text that is not empty, found ""'),
        (1.5, "1.5", "bad_id", "expected a text or an integer, found 1.5"),
        (True, "true", "bad_id", "expected a text or an integer, found true"),
        ([], "a list of 0", "bad_id",
         "expected a text or an integer, found a list of 0"),
        (2**64, "18446744073709551616", "number_too_large",
         "expected an id of at most 64 bits, found 18446744073709551616"),
    ],
)  # fmt: skip
def test_invalid_box_id_is_reported(value, label, code, words):
    faults = faults_of({"boxes": [{"id": value, "class": "car", "xyxy": [1, 2, 3, 4]}]})

    assert faults == [("/boxes/0/id", code, f"box 0 (id {label}), id: {words}")]


@pytest.mark.parametrize("again", ["217", 217])
def test_duplicate_box_id_is_a_fault(again):
    box = {"class": "car", "xyxy": [1, 2, 3, 4]}

    faults = faults_of({"boxes": [{**box, "id": "217"}, box, {**box, "id": again}]})

    ((pointer, code, detail),) = faults
    assert (pointer, code) == ("/boxes/2/id", "duplicate_id")
    assert detail.endswith(
        "id: expected an id that occurs once in the frame, "
        'found "217" again, after box 0'
    )
    # The id of a box without one is its index.
    by_default = faults_of({"boxes": [{**box, "id": "1"}, box]})
    assert [fault[:2] for fault in by_default] == [("/boxes/1/id", "duplicate_id")]
