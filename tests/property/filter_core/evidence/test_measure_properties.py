"""`measure` equals its definition on any image; all ways to count pixels agree."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from filter_core.evidence.counting import (
    Regions,
    count_by_pixels,
    count_by_tables,
    count_codes_in,
)
from filter_core.evidence.semantic import measure, with_accept_masks
from filter_core.frame_boxes import FrameBoxes
from filter_core.segmentation.reading import (
    SegmentationOptions,
    read_segmentation,
    segmentation_from_tags,
)
from tests.support.pictures import FAMILY, painted, png
from tests.support.slow_definitions import slow_counts

CLASSES = {"car": 1 << 14, "truck": 3 << 14, "walker": 1 << 12, "unicorn": 0}
KNOWN_TAGS = st.sampled_from(range(30))
SOME_TAGS = st.one_of(KNOWN_TAGS, st.just(14), st.just(255), st.just(77))


def pictures(elements=SOME_TAGS, fill=14):
    sides = npst.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=24)
    return npst.arrays(np.uint8, sides, elements=elements, fill=st.just(fill))


COORDINATE = st.one_of(
    st.integers(-3, 27).map(float),
    st.floats(-30.0, 60.0),
    st.sampled_from([-1e308, 1e308, -0.0, 1e-300, 23.999999999999996]),
)
BOXES = st.lists(st.tuples(*[COORDINATE] * 4), max_size=12)


def frame_boxes(picture, boxes, names):
    height, width = picture.shape
    classes = [names[index % len(names)] for index in range(len(boxes))]
    return FrameBoxes.of(
        np.array(boxes).reshape(-1, 4), classes, CLASSES, (width, height)
    )


names_of_classes = st.lists(st.sampled_from(sorted(CLASSES)), min_size=1, max_size=4)


@given(pictures(), BOXES, names_of_classes, st.data())
def test_measured_pixel_counts_equal_the_slow_definition(picture, boxes, names, data):
    ignore = data.draw(st.none() | npst.arrays(np.bool_, picture.shape))
    given_boxes = frame_boxes(picture, boxes, names)
    before = picture.copy(), given_boxes.xyxy.copy(), np.copy(ignore)

    rows = measure(segmentation_from_tags(picture, FAMILY), given_boxes, ignore=ignore)

    for now, then in zip((picture, given_boxes.xyxy, ignore), before, strict=True):
        np.testing.assert_array_equal(now, then)
    tags = np.where(picture < 30, picture, 255)
    assert rows.tag_counts is not None
    assert (rows.image_pixels == picture.size).all()
    for index, box in enumerate(given_boxes.xyxy):
        mask = int(given_boxes.accept_mask[index])
        expected = slow_counts(tags, box, mask, ignore)
        counted = rows.box_pixels[index], rows.matched_pixels[index]
        assert (*counted, rows.tag_counts[index].tolist()) == expected


@given(pictures(), BOXES, names_of_classes, st.data())
def test_changed_accept_masks_equal_measuring_again(picture, boxes, names, data):
    segmentation = segmentation_from_tags(picture, FAMILY)
    first = frame_boxes(picture, boxes, names)
    masks = npst.arrays(np.int64, len(boxes), elements=st.integers(0, (1 << 30) - 1))
    second = replace(first, accept_mask=data.draw(masks))

    measured = measure(segmentation, first)
    before = measured.matched_pixels.copy()

    changed = with_accept_masks(measured, second.accept_mask)

    np.testing.assert_array_equal(measured.matched_pixels, before)
    again = measure(segmentation, second)
    for name in ("matched_pixels", "match_percent", "crowding", "accept_mask"):
        np.testing.assert_array_equal(getattr(changed, name), getattr(again, name))


@pytest.mark.parametrize("form", ["tags", "rgb", "bgr"])
@given(pictures(KNOWN_TAGS), st.data())
def test_all_counting_strategies_give_the_same_counts(form, picture, data):
    height, width = picture.shape
    segmentation = (
        segmentation_from_tags(picture, FAMILY)
        if form == "tags"
        else read_segmentation(
            png(painted(picture), form),
            SegmentationOptions(palette=FAMILY, channel_order=form),
        )
    )
    columns = st.tuples(*[st.integers(0, width)] * 2).map(sorted)
    rows = st.tuples(*[st.integers(0, height)] * 2).map(sorted)
    drawn = data.draw(st.lists(st.tuples(columns, rows), max_size=8))
    bounds = np.array([(x0, y0, x1, y1) for (x0, x1), (y0, y1) in drawn], np.int64)
    keep = data.draw(st.none() | npst.arrays(np.bool_, picture.shape))
    regions = Regions(segmentation.codes, bounds.reshape(-1, 4), keep)
    codes = segmentation.codes.occurring

    by_pixels = count_by_pixels(regions, codes)

    np.testing.assert_array_equal(by_pixels, count_by_tables(regions, codes))
    np.testing.assert_array_equal(by_pixels, count_codes_in(regions, codes))
