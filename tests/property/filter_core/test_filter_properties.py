"""`filter_frame` (measuring and deciding together) equals a slow, simple definition."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filter_core.config.filter import FilterConfig
from filter_core.evidence.semantic import with_accept_sets
from filter_core.pipeline import filter_frame
from tests.support.slow_definitions import slow_edges

WH = (24, 16)
ACCEPTS = {"car": {14}, "van": {14, 15}, "walker": {12}, "kite": set()}
COORDINATE = st.one_of(
    st.integers(-8, 32).map(float), st.floats(-8, 32, allow_nan=False, width=32)
)


RECTANGLE = st.lists(COORDINATE, min_size=4, max_size=4).map(
    # Corners in order: others are refused where their box would be in the image.
    lambda c: [min(c[::2]), min(c[1::2]), max(c[::2]), max(c[1::2])]
)


@st.composite
def tag_images(draw):
    seed = draw(st.integers(0, 2**32 - 1))
    tags = np.random.default_rng(seed).choice([1, 9, 12, 14, 15], size=WH[::-1])
    return tags.astype(np.uint8)


BOXES = st.lists(
    st.fixed_dictionaries(
        {
            "class": st.sampled_from(sorted(ACCEPTS)),
            # Inside the first pixel it would be refused as a rectangle in shares.
            "xyxy": RECTANGLE.filter(lambda c: not all(0 <= x <= 1 for x in c)),
        },
        optional={"distance": st.floats(0, 300)},
    ),
    max_size=12,
)
CONFIGS = st.builds(
    FilterConfig,
    profile=st.just("paper"),
    threshold_small_box=st.integers(0, 100),
    size_big_box=st.integers(0, 100),
    threshold_big_box=st.integers(0, 100),
    min_visible_pixels=st.integers(0, 20),
    max_distance=st.one_of(st.none(), st.integers(0, 300)),
)


def slow_reason(box, tags, config):
    """The reason of one box by steps 1 to 3 of filter.md, one pixel at a time."""
    width, height = WH
    x_min, y_min, x_max, y_max = slow_edges(box["xyxy"])
    if x_min > width or y_min > height or x_max < 0 or y_max < 0:
        return "outside_image"
    x_min, x_max = (min(max(x, 0), width) for x in (x_min, x_max))
    y_min, y_max = (min(max(y, 0), height) for y in (y_min, y_max))
    if x_max <= x_min or y_max <= y_min:
        return "degenerate"
    far = config.max_distance is not None and "distance" in box
    if far and box["distance"] > config.max_distance:
        return "out_of_range"
    if not ACCEPTS[box["class"]]:
        return "unmapped_class"
    pixels = [
        int(tags[row, column])
        for row in range(math.floor(y_min), math.ceil(y_max))
        for column in range(math.floor(x_min), math.ceil(x_max))
    ]
    area = 100 * ((x_max - x_min) * (y_max - y_min)) / (width * height)
    return slow_threshold_reason(pixels, ACCEPTS[box["class"]], area, config)


def slow_threshold_reason(pixels, accepted, area, config):
    matched = sum(tag in accepted for tag in pixels)
    percent = 100 * matched / len(pixels)
    if matched < config.min_visible_pixels:
        return "no_visible_pixels"
    if area > config.size_big_box:
        fails = percent < config.threshold_big_box
        return "large_below_threshold" if fails else "visible"
    return "below_threshold" if percent < config.threshold_small_box else "visible"


@given(tag_images(), BOXES, CONFIGS)
def test_filter_frame_equals_the_slow_definition(tags, boxes, config):
    result = filter_frame({"carla_version": "0.9.15", "boxes": boxes}, tags, config)

    expected = [slow_reason(box, tags, config) for box in boxes]
    assert [box["reason"] for box in result.decisions] == expected
    for box in result.decisions:
        match, threshold = box["match_percent"], box["threshold"]
        margin = box["margin"]
        if threshold is None or match is None or margin is None:
            assert (threshold, margin, box["toss_up"]) == (None, None, False)
        else:
            assert margin == match - threshold
            assert (box["verdict"] == "kept") == (margin >= 0)
        if box["box_pixels"]:
            share = 100 * (box["matched_pixels"] or 0) / box["box_pixels"]
            assert match == pytest.approx(share)
        assert sum(hider["percent"] for hider in box["hidden_by"]) <= 100 + 1e-9


@given(tag_images(), BOXES)
def test_with_accept_sets_equals_measuring_again(tags, boxes):
    """The histogram of the first measurement gives the same as measuring again."""
    config = FilterConfig.from_mapping({"classes": {"car": {"accept": ["Truck", 9]}}})
    frame = {"carla_version": "0.9.15", "boxes": boxes}
    family = "carla-0.9.14"
    before = filter_frame(frame, tags).measured.evidence
    again = filter_frame(frame, tags, config).measured.evidence

    from_numbers = with_accept_sets(before, config.measuring(), family)

    differs = from_numbers.accept_mask != before.accept_mask
    assert differs.tolist() == [box["class"] == "car" for box in boxes]
    np.testing.assert_array_equal(from_numbers.matched_pixels, again.matched_pixels)
    np.testing.assert_array_equal(from_numbers.match_percent, again.match_percent)
    np.testing.assert_array_equal(from_numbers.crowding, again.crowding)
    assert with_accept_sets(again, config.measuring(), family) is again
