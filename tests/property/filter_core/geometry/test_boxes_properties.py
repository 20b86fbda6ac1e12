"""Rectangles are corrected and converted as slow definitions say; inputs are kept."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filter_core.evidence_numbers import BoxState
from filter_core.geometry.boxes import FORMS, correct_xyxy, pixel_bounds, to_xyxy
from tests.support.slow_definitions import slow_edges

WH = (64, 48)

# Whole numbers and the image's sides make it likely that boxes just touch an edge.
numbers = st.one_of(
    st.integers(-10, 80).map(float),
    st.sampled_from([0.0, -0.0, 48.0, 64.0, 1e9, -1e9, 5e-324]),
    st.floats(-100, 200),
)
boxes = st.lists(st.tuples(*[numbers] * 4), min_size=1, max_size=8)
proper = st.tuples(
    st.floats(-500, 500), st.floats(-500, 500), st.floats(0, 900), st.floats(0, 900)
).map(lambda box: [box[0], box[1], box[0] + box[2], box[1] + box[3]])


def slow_correction(box, profile):
    (x0, y0, x1, y1), (width, height) = slow_edges(box, profile), WH
    published = profile == "carlasimu"
    if x0 > width or y0 > height or x1 < 0 or y1 < 0 or (published and x0 >= width):
        return BoxState.OUTSIDE_IMAGE
    x0, x1 = (min(max(x, 0.0), width) for x in (x0, x1))
    y0, y1 = (min(max(y, 0.0), height) for y in (y0, y1))
    area = (x1 - x0) * (y1 - y0)
    if x1 <= x0 or y1 <= y0 or (published and area == 0):
        return BoxState.DEGENERATE
    if published and area >= width * height:
        return BoxState.COVERS_IMAGE
    return BoxState.MEASURABLE


@pytest.mark.parametrize("profile", ["paper", "carlasimu"])
@given(given_boxes=boxes)
def test_correct_xyxy_equals_the_slow_definition(profile, given_boxes):
    rows, states = correct_xyxy(given_boxes, WH, profile)

    assert [BoxState(int(s)) for s in states] == [
        slow_correction(box, profile) for box in given_boxes
    ]
    dropped = np.isin(states, [BoxState.OUTSIDE_IMAGE, BoxState.DEGENERATE])
    edges = np.array([slow_edges(box, profile) for box in given_boxes], np.float64)
    clamped = np.minimum(np.maximum(edges, 0), [*WH, *WH])
    np.testing.assert_array_equal(rows[~dropped], clamped[~dropped])
    assert np.isnan(rows[dropped]).all()


@given(given_boxes=boxes)
def test_pixel_bounds_are_the_pixels_that_the_box_touches(given_boxes):
    rows, states = correct_xyxy(given_boxes, WH)
    kept = rows[states == BoxState.MEASURABLE]

    bounds = pixel_bounds(kept, WH)

    for (x0, y0, x1, y1), bound in zip(kept, bounds.tolist(), strict=True):
        columns = [j for j in range(WH[0]) if j < x1 and j + 1 > x0]
        lines = [i for i in range(WH[1]) if i < y1 and i + 1 > y0]
        assert bound == [columns[0], lines[0], columns[-1] + 1, lines[-1] + 1]


def from_xyxy(form, xyxy):
    """Corners converted into another form: the inverse of `to_xyxy`."""
    boxes = np.reshape(np.asarray(xyxy, np.float64), (-1, 4))
    low, high = boxes[:, :2], boxes[:, 2:]
    if form.startswith("xywh"):
        boxes = np.hstack([low, high - low])
    elif form.startswith("cxcywh"):
        boxes = np.hstack([(low + high) / 2, high - low])
    return boxes / [*WH, *WH] if form.endswith("n") else boxes


@pytest.mark.parametrize("form", FORMS)
@given(given_boxes=st.lists(proper, max_size=5))
def test_every_box_format_round_trips_through_xyxy(form, given_boxes):
    there = from_xyxy(form, given_boxes)
    back = to_xyxy(form, there, WH)

    np.testing.assert_allclose(back, np.reshape(given_boxes, (-1, 4)), atol=1e-9)
