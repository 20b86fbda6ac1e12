"""Measuring boxes on small segmentations: pixels, matches, histograms, area."""

from dataclasses import replace

import numpy as np
import pytest

from filter_core.errors import (
    AnnotationError,
    FilterError,
    ImageSizeMismatch,
    SegmentationError,
)
from filter_core.evidence.semantic import MeasureOptions, measure, with_accept_masks
from filter_core.evidence_numbers import BoxState
from filter_core.segmentation.reading import read_segmentation, segmentation_from_tags
from tests.support.pictures import FAMILY, frame_boxes, painted, png, tag_image

PICTURE = tag_image(
    "......",
    ".cc.w.",
    ".cct??",
    "......",
)
WH = (6, 4)


def evidence(box, *, of="car", profile="paper", tags=PICTURE, ignore=None):
    """Measure one box."""
    boxes = frame_boxes([box], (tags.shape[1], tags.shape[0]), of)
    segmentation = segmentation_from_tags(tags, FAMILY)
    return measure(segmentation, boxes, MeasureOptions(profile), ignore=ignore)


@pytest.mark.parametrize(
    ("box", "pixels", "matched"),
    [
        pytest.param((1, 1, 3, 3), 4, 4, id="box filled by its class"),
        pytest.param((1, 1, 5, 3), 8, 4, id="half of it is something else"),
        pytest.param((-9, -9, 2, 2), 4, 1, id="only one corner is on the image"),
        pytest.param((-9, -9, 99, 99), 24, 4, id="larger than the image"),
        pytest.param((1.2, 1.2, 1.8, 1.8), 1, 1, id="smaller than one pixel"),
        pytest.param((2.9, 1.9, 3.1, 2.1), 4, 2, id="thin, but touches four pixels"),
        pytest.param((1, 1, 1.001, 3), 2, 2, id="a sliver has a column of its own"),
        pytest.param((5.999, 0, 6, 4), 4, 0, id="a sliver at the right edge"),
        pytest.param((0, 0, 1, 1), 1, 0, id="the first pixel"),
        pytest.param((0.98, 1, 3, 3), 6, 4, id="a hair over the edge of a pixel"),
        pytest.param((0.9999, 1, 3, 3), 4, 4, id="an edge that was rounded"),
    ],
)
def test_box_counts_every_pixel_that_it_touches(box, pixels, matched):
    measured = evidence(box)

    assert measured.state[0] == BoxState.MEASURABLE
    assert (measured.box_pixels[0], measured.matched_pixels[0]) == (pixels, matched)
    assert measured.match_percent[0] == 100.0 * matched / pixels
    assert measured.tag_counts[0].sum() == pixels


@pytest.mark.parametrize(
    ("box", "state"),
    [
        pytest.param((7, 0, 9, 4), BoxState.OUTSIDE_IMAGE, id="right of the image"),
        pytest.param((-5, 0, -1, 4), BoxState.OUTSIDE_IMAGE, id="left of the image"),
        pytest.param((3, 3, 1, 1), BoxState.DEGENERATE, id="inverted"),
        pytest.param((6, 0, 9, 4), BoxState.DEGENERATE, id="only touches the edge"),
        pytest.param((2, 2, 2, 3), BoxState.DEGENERATE, id="without width"),
    ],
)
def test_outside_or_degenerate_box_has_zero_pixels_and_match(box, state):
    measured = evidence(box)

    assert measured.state[0] == state
    assert np.isnan(measured.xyxy).all()
    assert (measured.box_pixels[0], measured.matched_pixels[0]) == (0, 0)
    assert (measured.match_percent[0], measured.area_percent[0]) == (0, 0)
    assert not measured.tag_counts.any()


def test_unmapped_class_unknown_and_ignored_pixels_match_nothing():
    measured = evidence((1, 1, 3, 3), of="unicorn")
    everything = frame_boxes([(4, 2, 6, 3)], WH, accept={"car": (1 << 62) - 1})

    unknown = measure(segmentation_from_tags(PICTURE, FAMILY), everything)

    assert (measured.accept_mask[0], measured.matched_pixels[0]) == (0, 0)
    assert unknown.matched_pixels[0] == 0
    ignored = evidence((1, 1, 3, 3), ignore=np.ones(PICTURE.shape, np.bool_))
    assert (ignored.box_pixels[0], ignored.match_percent[0]) == (0, 0.0)
    # The area is that of the box, and not of its pixels.
    assert evidence((1.5, 1.5, 3.5, 2.5)).area_percent[0] == 2.0 / 24 * 100


def test_geometry_is_measured_without_a_segmentation():
    boxes = frame_boxes([(1, 1, 3, 3), (1, 1, 2, 3)], WH)

    measured = measure(None, boxes)

    assert not measured.measured.any()
    assert np.isnan(measured.match_percent).all()
    assert measured.tag_counts is None
    assert measured.box_pixels.tolist() == [4, 2]
    assert measured.crowding.tolist() == [50.0, 100.0]
    changed = with_accept_masks(measured, np.full(2, 1 << 12))
    assert np.isnan(changed.match_percent).all()
    none = measure(segmentation_from_tags(PICTURE, FAMILY), frame_boxes([], WH))
    assert len(none) == 0
    assert none.tag_counts is not None
    assert none.tag_counts.shape == (0, 31)


@pytest.mark.parametrize("what", ["segmentation", "ignore mask"])
def test_size_mismatch_error_names_segmentation_or_ignore_mask(what):
    segmentation = segmentation_from_tags(PICTURE, FAMILY)
    ignore = np.zeros((6, 4), np.bool_) if what == "ignore mask" else None
    wh = WH if what == "ignore mask" else (4, 6)

    with pytest.raises(ImageSizeMismatch, match=f"the {what} is . x . pixels"):
        measure(segmentation, frame_boxes([(0, 0, 1, 1)], wh), ignore=ignore)
    with pytest.raises(AnnotationError, match="box 1: "):
        measure(segmentation, frame_boxes([(1, 1, 3, 3), (1, np.nan, 3, 3)], WH))


class TestProfileCarlasimu:
    """Profile `carlasimu` gives exactly the numbers of the paper's published code."""

    @pytest.mark.parametrize(
        ("box", "pixels", "matched", "percent"),
        [
            pytest.param((1, 1, 3, 3), 4, 4, 100.0, id="whole numbers"),
            pytest.param((1.9, 1.9, 3.9, 3.9), 4, 4, 100.0, id="fractions are dropped"),
            pytest.param((1.6, 1.0, 3.0, 3.0), 4, 4, 4 / 2.8 * 100, id="over 100 %"),
            pytest.param((1.2, 1.2, 1.8, 1.8), 0, 0, 0.0, id="thin: no pixel"),
        ],
    )
    def test_counts_a_truncated_crop_over_the_float_area(
        self, box, pixels, matched, percent
    ):
        measured = evidence(box, profile="carlasimu")
        larger = evidence((-1, -1, 7, 5), profile="carlasimu")

        assert larger.state[0] == BoxState.COVERS_IMAGE
        assert (measured.box_pixels[0], measured.matched_pixels[0]) == (pixels, matched)
        assert measured.match_percent[0] == pytest.approx(percent, rel=1e-15)

    def test_counts_the_class_colour_that_the_palette_family_lacks(self):
        rgb = painted(np.full((8, 20), 1, np.uint8))
        rgb[0, 0] = (100, 40, 40)  # Fence in carlasimu's table and carla-0.9.10
        rgb[2:6, 2:6] = (0, 60, 100)  # Bus, a tag that carla-0.9.10 lacks
        segmentation = read_segmentation(png(rgb))
        boxes = frame_boxes([(2, 2, 6, 6)], (20, 8), "bus", {"bus": 0})

        measured = measure(segmentation, boxes, MeasureOptions(profile="carlasimu"))

        assert measured.match_percent[0] == 100.0

    @pytest.mark.parametrize("order", ["rgb", "bgr"])
    def test_counts_by_colour_in_either_channel_order(self, order):
        segmentation = read_segmentation(png(painted(PICTURE[:2]), order))
        boxes = frame_boxes([(1, 1, 3, 2)], (6, 2), "truck")

        measured = measure(segmentation, boxes, MeasureOptions(profile="carlasimu"))

        assert (segmentation.channel_order, measured.match_percent[0]) == (order, 100.0)


class TestAmbiguousPalette:
    """The image fits two families: (0, 0, 142) is Car in one, Vehicle in the other."""

    AMBIGUOUS = png(painted(tag_image("ssss", ".cc.")))

    @pytest.mark.parametrize(
        ("name", "tag", "percent"),
        [
            pytest.param("car", 14, 100.0, id="equal in both families"),
            pytest.param("walker", 12, 0.0, id="equal in both, and matches nothing"),
            pytest.param("bus", 14, 100.0, id="as the configuration says"),
        ],
    )
    def test_class_with_one_accept_set_is_measured(self, name, tag, percent):
        boxes = frame_boxes([(1, 1, 3, 2)], (4, 2), name, {name: 1 << tag})

        measured = measure(read_segmentation(self.AMBIGUOUS), boxes)

        assert measured.match_percent[0] == percent

    def test_class_that_differs_between_the_families_is_refused(self):
        boxes = frame_boxes([(1, 1, 3, 2)], (4, 2), "bus", {"bus": 1 << 16})

        with pytest.raises(SegmentationError) as caught:
            measure(read_segmentation(self.AMBIGUOUS), boxes)

        assert caught.value.kind == "ambiguous_palette"
        assert str(caught.value).startswith(
            "the colours that occur fit carla-0.9.14 and carla-0.9.10, which differ in "
            "what counts as bus; name the palette"
        )


class TestWithAcceptMasks:
    BOXES = ((1, 1, 3, 3), (1, 1, 5, 3), (7, 0, 9, 4))

    def measured(self, mask):
        boxes = frame_boxes(self.BOXES, WH, accept={"car": mask})
        return measure(segmentation_from_tags(PICTURE, FAMILY), boxes)

    @pytest.mark.parametrize("missing", ["tag_counts", "xyxy"])
    def test_missing_histogram_or_boxes_raises_error(self, missing):
        measured = replace(self.measured(1 << 14), **{missing: None})

        with pytest.raises(FilterError, match="need the tag histogram") as caught:
            with_accept_masks(measured, np.full(3, 1 << 12))

        assert caught.value.kind == "no_histogram"
