"""Rectangles: their forms, their correction (Algorithm 1), the pixels they touch."""

from typing import Any

import numpy as np
import pytest

from filter_core.errors import AnnotationError, FilterError
from filter_core.evidence_numbers import BoxState
from filter_core.geometry.boxes import correct_xyxy, pixel_bounds, to_xyxy

WH = (200, 100)
NAN_RECTANGLE = [float("nan")] * 4


def corrected(box, profile="paper"):
    rows, states = correct_xyxy([box], WH, profile)
    return rows[0].tolist(), BoxState(int(states[0]))


@pytest.mark.parametrize("values", [[1, 2, 3, 4], [[1, 2, 3]], [[[1, 2, 3, 4]]]])
def test_array_without_four_columns_unknown_form_or_profile_is_refused(values):
    with pytest.raises(FilterError, match=r"expected an array of shape \(N, 4\)"):
        correct_xyxy(values, WH)
    with pytest.raises(FilterError, match="expected one of xyxy, xyxyn, xywh") as fault:
        to_xyxy("ltrb", [[1, 2, 3, 4]], WH)
    assert fault.value.kind == "bad_form"
    profile: Any = "papre"
    with pytest.raises(FilterError, match="expected paper or carlasimu, found 'papre'"):
        correct_xyxy([[1, 2, 3, 4]], WH, profile)


def test_no_boxes_give_empty_arrays():
    rows, states = correct_xyxy([], WH)

    assert (rows.shape, states.shape) == ((0, 4), (0,))
    assert to_xyxy("xywh", [], WH).shape == (0, 4)
    assert pixel_bounds(rows, WH).shape == (0, 4)


CORRECTED = {
    "inside": ([10, 20, 30, 40], [10, 20, 30, 40], BoxState.MEASURABLE),
    "clamped": ([-5, -5, 300, 50], [0, 0, 200, 50], BoxState.MEASURABLE),
    "covers it": ([-1, -1, 201, 101], [0, 0, 200, 100], BoxState.MEASURABLE),
    "right of it": ([200.5, 0, 300, 50], NAN_RECTANGLE, BoxState.OUTSIDE_IMAGE),
    "left of it": ([-9, 0, -1, 50], NAN_RECTANGLE, BoxState.OUTSIDE_IMAGE),
    "below it": ([0, 101, 9, 150], NAN_RECTANGLE, BoxState.OUTSIDE_IMAGE),
    "above it": ([0, -9, 9, -0.1], NAN_RECTANGLE, BoxState.OUTSIDE_IMAGE),
    "touches the right edge": ([200, 0, 300, 50], NAN_RECTANGLE, BoxState.DEGENERATE),
    "touches the left edge": ([-9, 0, 0, 50], NAN_RECTANGLE, BoxState.DEGENERATE),
    "no width": ([10, 10, 10, 40], NAN_RECTANGLE, BoxState.DEGENERATE),
    "inverted": ([30, 10, 10, 40], NAN_RECTANGLE, BoxState.DEGENERATE),
    "inverted, min out": ([250, 10, 10, 40], NAN_RECTANGLE, BoxState.OUTSIDE_IMAGE),
}


@pytest.mark.parametrize(
    ("box", "expected", "state"), CORRECTED.values(), ids=CORRECTED
)
def test_correct_xyxy_follows_algorithm_1(box, expected, state):
    assert corrected(box) == (pytest.approx(expected, abs=0, nan_ok=True), state)


ROUNDED = {
    "six decimals of YOLO": ([101, 53.0002, 107, 59.0002], [101, 53, 107, 59]),
    "at the tolerance": ([100.99, 53.01, 107.01, 58.99], [101, 53, 107, 59]),
    "beyond it": ([100.98, 53.011, 107, 59.02], [100.98, 53.011, 107, 59.02]),
    "fractions": ([0.5, 1.25, 2.5, 3], [0.5, 1.25, 2.5, 3]),
    "around zero": ([-0.004, 0, 5, 5], [0, 0, 5, 5]),
    "at the image": ([0, 0, 199.995, 100.004], [0, 0, 200, 100]),
    "thinner than that": ([9.996, 20, 10.004, 30.001], [9.996, 20, 10.004, 30]),
}


@pytest.mark.parametrize(("box", "expected"), ROUNDED.values(), ids=ROUNDED)
def test_edges_that_were_rounded_become_whole_numbers_again(box, expected):
    rectangle, state = corrected(box)
    as_given, _ = correct_xyxy([box], WH, rounded_edges=False)
    as_published, _ = correct_xyxy([box], WH, "carlasimu")

    assert (rectangle, state) == (expected, BoxState.MEASURABLE)
    clamped = np.clip(box, 0, [*WH, *WH]).tolist()
    assert as_given[0].tolist() == as_published[0].tolist() == clamped


PUBLISHED = {
    "x_min at the width": ([200, 0, 300, 50], BoxState.OUTSIDE_IMAGE),
    "y_min at the height": ([0, 100, 9, 150], BoxState.DEGENERATE),
    "covers the image": ([-1, -1, 201, 101], BoxState.COVERS_IMAGE),
    "nearly covers it": ([0, 0, 200, 99.9], BoxState.MEASURABLE),
    "a sliver": ([1, 1, 1 + 1e-9, 2], BoxState.MEASURABLE),
    "area rounds to 0": ([0, 0, 1e-200, 1e-200], BoxState.DEGENERATE),
}


@pytest.mark.parametrize(("box", "state"), PUBLISHED.values(), ids=PUBLISHED)
def test_profile_carlasimu_decides_as_the_published_code(box, state):
    assert corrected(box, "carlasimu")[1] is state


@pytest.mark.parametrize("number", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("profile", ["paper", "carlasimu"])
def test_non_finite_number_raises_error_naming_the_box(number, profile):
    with pytest.raises(AnnotationError, match="box 1: expected four finite") as fault:
        correct_xyxy([[1, 2, 3, 4], [1, 2, number, 4]], WH, profile)

    assert (fault.value.kind, fault.value.pointer) == ("not_finite", "/boxes/1")


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        pytest.param([0, 0, 1, 1], [0, 0, 1, 1], id="exactly the first pixel"),
        pytest.param([0.5, 0.5, 1.5, 1.5], [0, 0, 2, 2], id="touches four pixels"),
        pytest.param([5.2, 7.1, 5.8, 7.2], [5, 7, 6, 8], id="thinner than a pixel"),
        pytest.param([5, 7, 5, 7], [5, 7, 6, 8], id="a point still has one"),
        pytest.param([199.5, 99.5, 200, 100], [199, 99, 200, 100], id="last pixel"),
        pytest.param([200, 100, 200, 100], [199, 99, 200, 100], id="on the far edge"),
        pytest.param(NAN_RECTANGLE, [0, 0, 0, 0], id="no box, no pixel"),
    ],
)
def test_pixel_bounds_include_every_touched_pixel(box, expected):
    assert pixel_bounds([box], WH).tolist() == [expected]


def test_inputs_are_not_changed():
    boxes = np.array([[-5.0, -5.0, 300.0, 50.0], [30.0, 10.0, 10.0, 40.0]])
    before = boxes.copy()

    correct_xyxy(boxes, WH)
    pixel_bounds(boxes, WH)
    to_xyxy("xyxy", boxes, WH)[0, 0] = 99

    np.testing.assert_array_equal(boxes, before)
