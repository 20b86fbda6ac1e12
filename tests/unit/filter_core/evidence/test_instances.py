"""Instance images: reading them, and assigning each box its instance."""

from dataclasses import replace

import numpy as np
import pytest

from filter_core.errors import ImageError
from filter_core.evidence.instances import (
    InstanceImage,
    fill_instances,
    group_pixels,
    read_instances,
    settled_instances,
)
from filter_core.evidence.silhouettes import frame_silhouettes
from filter_core.evidence_numbers import ChannelNumbers
from filter_core.frame_boxes import FrameBoxes
from filter_core.segmentation.reading import segmentation_from_tags
from tests.support.pictures import FAMILY, jpeg, painted, png, with_alpha
from tests.support.sensors import depth_png, instance_png, street_metres

CAR, WALKER, ROAD = 14, 12, 1
CARS = 1 << CAR


def measured(tags, ids, xyxy, *, distance=None, accept=CARS, ids_of=None):
    """The instance channel's numbers of boxes in one image."""
    image = read_instances(instance_png(tags, ids))
    count, wh = len(xyxy), image.tags.shape[::-1]
    boxes = FrameBoxes.of(xyxy, ["car"] * count, {"car": accept}, wh, distance)
    boxes = replace(boxes, instance_id=np.array(ids_of or [-1] * count, np.int64))
    numbers = ChannelNumbers.absent(count)
    outlines = frame_silhouettes(boxes.xyxy, boxes.vertices, None, wh)
    fill_instances(numbers, image, boxes, outlines)
    return numbers


def two_cars() -> tuple[np.ndarray, np.ndarray]:
    """Tags and ids of two cars: one of 6 x 4 px (id 54321), one of 3 x 4 px (77)."""
    ids = np.zeros((6, 12), int)
    ids[1:5, 1:7], ids[1:5, 8:11] = 54_321, 77
    return np.where(ids > 0, CAR, 0), ids


def test_instance_ids_are_read_with_16_bits():
    image = read_instances(
        instance_png(np.array([[CAR, WALKER]]), np.array([[65_535, 256]]))
    )

    assert image.tags.tolist() == [[CAR, WALKER]]
    assert image.ids.tolist() == [[65_535, 256]]


def street_of_cars() -> tuple[np.ndarray, np.ndarray]:
    """Tags and ids of two cars on a road; all ids are small enough to pass for tags."""
    tags, ids = np.full((60, 80), ROAD), np.full((60, 80), 3 * 256)
    tags[20:40, 10:40], ids[20:40, 10:40] = CAR, 29 * 256 + 255
    tags[25:35, 50:60], ids[25:35, 50:60] = CAR, 14 * 256 + 1
    return tags, ids


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("high_byte", [None, ROAD, CAR])
def test_segmentation_tells_the_order_of_channels(swapped, high_byte):
    tags, ids = street_of_cars()
    if high_byte is not None:
        ids = (ids & 255) | high_byte << 8
    segmentation = segmentation_from_tags(tags.astype(np.uint8), FAMILY)

    image = read_instances(instance_png(tags, ids, swapped=swapped), segmentation)

    assert image.order == ("bgr" if swapped else "rgb")
    assert len(image.notes) == swapped
    np.testing.assert_array_equal(image.tags, tags)
    np.testing.assert_array_equal(image.ids, ids)


@pytest.mark.parametrize("swapped", [False, True])
def test_boxes_an_empty_channel_or_some_objects_tell_the_order(swapped):
    tags, ids = street_of_cars()
    order = "bgr" if swapped else "rgb"
    image = read_instances(instance_png(tags, ids, swapped=swapped))
    boxes = FrameBoxes.of([[10, 20, 40, 40]], ["car"], {"car": CARS}, (80, 60))
    outlines = frame_silhouettes(boxes.xyxy, boxes.vertices, None, (80, 60))

    settled = settled_instances(image, boxes, outlines)
    by_channel = read_instances(instance_png(tags, ids & 255, swapped=swapped))

    assert settled.order == order
    np.testing.assert_array_equal(settled.tags, tags)
    np.testing.assert_array_equal(settled.ids, ids)
    assert (by_channel.order, by_channel.is_certain) == (order, True)
    # Instances of some objects alone agree with a segmentation, too.
    segmentation = segmentation_from_tags(tags.astype(np.uint8), FAMILY)
    cars = instance_png(np.where(tags == CAR, tags, 0), ids, swapped=swapped)
    assert read_instances(cars, segmentation).order == order


NOISE = np.random.default_rng(1).integers(0, 256, (60, 80, 3)).astype(np.uint8)


OTHER_IMAGES = {
    "segmentation": (png(painted(street_of_cars()[0])), "bad_instances"),
    "photo": (png(with_alpha(NOISE)), "bad_instances"),
    "jpeg": (jpeg(NOISE), "lossy_instances"),
    "depth": (depth_png(street_metres(60, 80)), "bad_instances"),
    "black": (png(np.zeros((60, 80, 3), np.uint8)), "bad_instances"),
    "grey": (png(np.zeros((60, 80), np.uint8)), "bad_instances"),
    "no tags": (png(np.full((60, 80, 3), 99, np.uint8)), "bad_instances"),
}


@pytest.mark.parametrize("has_segmentation", [False, True])
@pytest.mark.parametrize(("content", "code"), OTHER_IMAGES.values(), ids=OTHER_IMAGES)
def test_image_of_another_sensor_is_refused(content, code, has_segmentation):
    tags = street_of_cars()[0].astype(np.uint8)
    segmentation = segmentation_from_tags(tags, FAMILY) if has_segmentation else None

    with pytest.raises(ImageError) as refused:
        read_instances(content, segmentation)

    assert refused.value.kind == code


SIX_BY_FOUR, THREE_BY_FOUR = [1, 1, 7, 5], [8, 1, 11, 5]
BOXES = {
    "each has its own instance": ([THREE_BY_FOUR, SIX_BY_FOUR], {}, [12, 24]),
    "a ghost behind a car has none": (
        [SIX_BY_FOUR, [2, 2, 6, 4]],
        {"distance": [10.0, 40.0]},
        [24, 0],
    ),
    "a given instance also counts outside of the box": (
        [SIX_BY_FOUR, [0, 0, 2, 2]],
        {"ids_of": [-1, 0x1_0000 + 77]},
        [24, 12],
    ),
    "a given instance is not in the image": ([SIX_BY_FOUR], {"ids_of": [4]}, [0]),
    "its tags are not accepted": ([SIX_BY_FOUR], {"accept": 1 << WALKER}, [0]),
}


@pytest.mark.parametrize(("boxes", "options", "pixels"), BOXES.values(), ids=BOXES)
def test_pixels_of_a_box_are_those_of_its_instance(boxes, options, pixels):
    numbers = measured(*two_cars(), boxes, **options)

    assert numbers.instance_pixels.tolist() == pixels
    for tight, box, count in zip(numbers.tight_xyxy, boxes, pixels, strict=True):
        if not count:
            assert np.isnan(tight).all()
        elif "ids_of" not in options:
            assert tight.tolist() == box


def test_fragment_is_assigned_to_the_nearer_box_not_by_size():
    ids = np.zeros((20, 40), int)
    ids[8:10, 16:20] = 5
    hidden_car, far_ghost = [10, 2, 30, 14], [16, 8, 20, 10]

    numbers = measured(
        np.where(ids > 0, CAR, 0), ids, [far_ghost, hidden_car], distance=[150.0, 20.0]
    )

    assert numbers.instance_pixels.tolist() == [0, 8]


@pytest.mark.parametrize("mask", [0, 1, CARS, 0b101 << 13, 1 << 29, (1 << 63) - 1])
def test_pixels_are_grouped_by_instance_if_their_tags_are_accepted(mask):
    tags = np.arange(256, dtype=np.uint8)
    image = InstanceImage(tags[None], tags.astype(np.uint16)[None])
    expected = [tag for tag in range(30) if mask >> tag & 1]

    pixels = group_pixels(image, [(1 << 30) - 1])
    accepted = [row for row in range(len(pixels)) if pixels.accepted(row, mask)[0]]

    assert group_pixels(image, [mask]).ids.tolist() == expected
    assert pixels.ids[accepted].tolist() == expected
