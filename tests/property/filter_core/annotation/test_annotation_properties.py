"""Any JSON is read as an annotation, or refused with place and cause of each error."""

import copy
import json

from hypothesis import given
from hypothesis import strategies as st

from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import AnnotationErrors

BOX_KEYS = ["id", "class", "type_id", "distance", "instance_id", "extra"]
GEOMETRY_KEYS = ["xyxy", "xywh", "cxcywhn", "vertices", "box3d", "extent", "transform"]
CAMERA_KEYS = ["width", "height", "fov", "x", "y", "z", "yaw"]
KEYS = [*BOX_KEYS, *GEOMETRY_KEYS, *CAMERA_KEYS, "other"]
leaves = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)
)
values = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.lists(inner, max_size=8),
        st.dictionaries(st.sampled_from(KEYS), inner, max_size=5),
    ),
    max_leaves=12,
)
odd_boxes = st.dictionaries(st.sampled_from(KEYS), values, max_size=6)
numbers = st.floats(-1e9, 1e9)
good_boxes = st.fixed_dictionaries(
    {
        "class": st.sampled_from(["car", "van"]),
        "xyxy": st.lists(numbers, min_size=4, max_size=4),
    },
    optional={"distance": st.floats(0, 1e6), "mine": st.integers(-5, 5)},
)
frames = st.fixed_dictionaries(
    {"boxes": st.lists(st.one_of(odd_boxes, good_boxes), max_size=4)},
    optional={"camera": values, "weather": values, "sensors": values, "note": values},
)


def errors_of(raw):
    try:
        parse_annotation(raw)
    except AnnotationErrors as refused:
        return refused.errors
    return ()


@given(raw=frames)
def test_every_annotation_error_names_its_box_and_expected_and_found(raw):
    before = copy.deepcopy(raw)

    for fault in errors_of(raw):
        assert fault.kind
        assert ": expected " in fault.detail
        assert ", found " in fault.detail
        if fault.pointer.startswith("/boxes/"):
            index = fault.pointer.split("/")[2]
            assert fault.detail.startswith(f"box {index} (id ")
    assert repr(raw) == repr(before)


@given(raw=frames)
def test_json_bytes_give_the_same_errors_as_the_mapping(raw):
    errors = errors_of(raw)

    content = json.dumps(raw).encode()
    by_content = [(fault.pointer, fault.kind) for fault in errors_of(content)]

    assert by_content == [(fault.pointer, fault.kind) for fault in errors]
    if not errors:
        # What is kept of the annotation is valid JSON.
        read = parse_annotation(raw)
        kept = [read.raw, *(box.raw for box in read.boxes)]
        json.dumps(kept, allow_nan=False, ensure_ascii=False).encode()


@given(boxes=st.lists(good_boxes, max_size=6))
def test_valid_boxes_keep_their_values_ids_and_unknown_keys(boxes):
    read = parse_annotation({"boxes": boxes}).boxes

    assert [list(box.values) for box in read] == [box["xyxy"] for box in boxes]
    assert [box.id for box in read] == [str(i) for i in range(len(boxes))]
    assert [box.raw for box in read] == boxes


@given(raw=st.binary(max_size=40))
def test_any_bytes_are_parsed_or_raise_annotation_errors(raw):
    errors_of(raw)
