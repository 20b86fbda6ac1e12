"""All kinds of evidence interpret the mask of accepted tags in the same way."""

from __future__ import annotations

import numpy as np
import pytest

from filter_core.evidence.instances import InstanceImage, group_pixels
from filter_core.evidence.lidar import LidarPoints, points_inside
from filter_core.evidence.semantic import measure, with_accept_masks
from filter_core.evidence.silhouettes import accepted_pixels, frame_silhouettes
from filter_core.frame_boxes import FrameBoxes
from filter_core.geometry.pose import Transform
from filter_core.segmentation.reading import segmentation_from_tags
from tests.support.sensors import box_ahead

TAGS = np.arange(256, dtype=np.uint8)
FAMILY = "carla-0.9.14"
LAST_TAG = 29

MASKS = [
    0,
    1,
    1 << 14,
    1 << LAST_TAG,
    0b101 << 13,
    (1 << LAST_TAG + 1) - 1,
    (1 << 63) - 1,  # also has bits of tags that do not exist
]


@pytest.fixture(params=MASKS, ids=hex)
def mask(request):
    return request.param


@pytest.fixture
def expected(mask):
    return [tag for tag in range(256) if tag <= LAST_TAG and mask >> tag & 1]


def one_box_per_tag(mask):
    """256 boxes of one pixel each, in an image of one row whose pixel t has tag t."""
    xyxy = np.array([[tag, 0, tag + 1, 1] for tag in range(256)], np.float64)
    return FrameBoxes.of(xyxy, ["car"] * 256, {"car": mask}, (256, 1))


def segmentation():
    return segmentation_from_tags(TAGS[None], FAMILY)


def test_measure_counts_only_pixels_of_accepted_tags(mask, expected):
    evidence = measure(segmentation(), one_box_per_tag(mask))

    assert np.flatnonzero(evidence.matched_pixels).tolist() == expected


def test_with_accept_masks_counts_only_accepted_tags(mask, expected):
    measured = measure(segmentation(), one_box_per_tag(0))

    evidence = with_accept_masks(measured, np.full(256, mask))

    assert np.flatnonzero(evidence.matched_pixels).tolist() == expected


def test_accepted_pixels_of_silhouettes_have_accepted_tags(mask, expected):
    boxes = one_box_per_tag(mask)
    outlines = frame_silhouettes(
        boxes.xyxy, np.full((256, 8, 3), np.nan), None, (256, 1)
    )

    found = accepted_pixels(outlines, segmentation().codes, boxes.accept_mask)

    assert [box.silhouette.row for box in found if box.mask.any()] == expected


def test_instance_pixels_are_grouped_by_accepted_tags(mask, expected):
    image = InstanceImage(TAGS[None], np.arange(256, dtype=np.uint16)[None])
    everything = (1 << LAST_TAG + 1) - 1

    grouped = group_pixels(image, [mask])
    pixels = group_pixels(image, [everything])
    accepted = [row for row in range(len(pixels)) if pixels.accepted(row, mask)[0]]

    assert grouped.ids.tolist() == expected
    assert pixels.ids[accepted].tolist() == expected


def test_lidar_points_inside_counts_only_accepted_tags(mask, expected):
    place = np.full((1, 3), [10.0, 0.0, 0.0])
    box = box_ahead(10.0, 1.0)[None]

    counted = [
        tag
        for tag in range(256)
        if points_inside(
            LidarPoints(place, np.array([tag])),
            Transform(),
            box,
            np.array([mask]),
        )[0]
    ]

    assert counted == expected
