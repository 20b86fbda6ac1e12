"""Segmentations that other people recorded with CARLA, with their mistakes."""

import numpy as np
import pytest

from filter_core.evidence.semantic import measure
from filter_core.images.ignore_mask import read_ignore_mask
from filter_core.segmentation.palettes import FAMILIES
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation
from tests.support.pictures import frame_boxes, pixels_of
from tests.support.shared_data import shared

SWAPPED = "data/ee267-litian-gong/report/Part5_output"
GENERATOR = "data/Daniel-ChenJH_Carla-Dataset-Generator"
JPEG = f"{GENERATOR}/record_data/runs1/Segment_Camera/Frame_1954.jpg"
BONNET = [[330, 719], [420, 600], [860, 600], [950, 719]]


def content(path: str) -> bytes:
    return shared(path).read_bytes()


def test_raw_tags_in_the_blue_channel_are_recognised():
    found = read_segmentation(content(f"{SWAPPED}/semantic_id_r.png"))

    recognised = (found.family, found.encoding, found.channel_order)
    assert recognised == ("carla-0.9.14", "raw", "bgr")
    assert (found.unknown_pixels, found.tags.shape) == (0, (720, 1280))
    # The blue channel of the file has these tags this often.
    assert np.bincount(found.tags.ravel())[[1, 3, 14]].tolist() == [
        130584,
        550598,
        1797,
    ]
    assert found.notes == ("the raw tags are in the blue channel",)


def test_palette_images_written_as_jpeg_are_read_by_the_nearest_colour():
    found = read_segmentation(content(JPEG), SegmentationOptions(lossy="nearest"))

    assert (found.family, found.lossy) == ("carla-0.9.14", True)
    assert 1.0 < found.unknown_percent < 1.5
    assert int((found.tags == 255).sum()) == found.unknown_pixels


def test_bonnet_under_an_ignore_mask_is_not_counted():
    segmentation = read_segmentation(
        content(JPEG), SegmentationOptions(lossy="nearest")
    )
    boxes = frame_boxes([(330, 600, 950, 720)], segmentation.wh)
    bonnet = read_ignore_mask([BONNET], segmentation.wh)

    without, with_mask = (
        measure(segmentation, boxes, ignore=ignore) for ignore in (None, bonnet)
    )

    assert without.match_percent[0] > 50
    assert with_mask.matched_pixels[0] < without.matched_pixels[0] / 4


SELMA = "cases/recordings/selma/Town01_Opt_ClearNight"
OF_SELMA = {
    "40": "Pedestrian",
    "41": "Rider",
    "100": "Car",
    "101": "Truck",
    "102": "Bus",
    "103": "Train",
    "104": "Motorcycle",
    "105": "Bicycle",
}


@pytest.mark.parametrize("camera", ["FRONT", "LEFT"])
def test_named_tags_of_a_changed_carla_have_as_many_pixels_as_their_numbers(camera):
    (path,) = shared(f"{SELMA}/SEGCAM_{camera}").iterdir()
    numbers = pixels_of(path.read_bytes())
    options = SegmentationOptions(palette="carla-0.9.10", tags=OF_SELMA)
    tag_of = FAMILIES["carla-0.9.14"].tag_of

    found = read_segmentation(path.read_bytes(), options)

    assert found.unknown_pixels == 0
    for number, name in OF_SELMA.items():
        assert (found.tags == tag_of(name)).sum() == (numbers == int(number)).sum()
    cars = measure(
        found, frame_boxes([[0, 0, 1280, 640]], (1280, 640), "car", {"car": 1 << 14})
    )
    assert cars.matched_pixels.tolist() == [(numbers == 100).sum()]
