"""Segmentations that other people recorded with CARLA, with their mistakes."""

import pytest

from filter_core.evidence.semantic import measure
from filter_core.segmentation.palettes import FAMILIES
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation
from tests.support.pictures import frame_boxes, pixels_of
from tests.support.shared_data import shared

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

    image = read_segmentation(path.read_bytes(), options)

    assert image.unknown_pixels == 0
    for number, name in OF_SELMA.items():
        assert (image.tags == tag_of(name)).sum() == (numbers == int(number)).sum()
    cars = measure(
        image, frame_boxes([[0, 0, 1280, 640]], (1280, 640), "car", {"car": 1 << 14})
    )
    assert cars.matched_pixels.tolist() == [(numbers == 100).sum()]
