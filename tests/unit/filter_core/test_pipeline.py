"""`filter_frame`: one frame measured and decided, as users of the library do it."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from IPython.core.formatters import HTMLFormatter

from filter_core.config.filter import FilterConfig
from filter_core.decisions.record import Decision
from filter_core.errors import ImageSizeMismatch, SegmentationError
from filter_core.pipeline import FrameOptions, filter_frame
from filter_core.segmentation.reading import SegmentationOptions
from tests.support.folders import street_tags
from tests.support.lidar import npy
from tests.support.pictures import painted, png
from tests.support.sensors import ANNOTATION, HEIGHT, WIDTH, instance_png, scene
from tests.support.sensors import CAR as CAR_TAG

KEYS = list(Decision.__annotations__)
STREET = png(painted(street_tags()))
"""The segmentation of a street with one car."""


def annotation(*boxes, **more):
    return {"carla_version": "0.9.15", "boxes": list(boxes), **more}


CAR = {"id": "217", "class": "car", "xyxy": [10, 10, 50, 40], "distance": 12.5}
GHOST = {"id": "218", "class": "walker", "xyxy": [60, 40, 70, 55]}


def test_result_draws_itself_in_a_notebook():
    result = filter_frame(annotation(CAR, GHOST), STREET)

    drawing = ElementTree.fromstring(HTMLFormatter()(result))

    boxes = drawing.findall("rect")
    assert [each.get("stroke-dasharray") is None for each in boxes] == [True, False]
    assert (boxes[0].findtext("title") or "").startswith("car 217, kept: ")


def test_decision_has_all_keys_of_the_api():
    by_tags = FilterConfig(profile="paper")
    options = FrameOptions(key="a/7")

    result = filter_frame(annotation(CAR), STREET, by_tags, options=options)

    (decision,) = result.decisions
    assert list(decision) == KEYS
    assert decision == {
        **dict.fromkeys(KEYS),
        "id": "217",
        "frame": "a/7",
        "class": "car",
        "verdict": "kept",
        "reason": "visible",
        "explanation": "kept: 100 % of its pixels are Car, 10 % are needed",
        "evidence": "semantic",
        "match_percent": 100.0,
        "threshold": 10.0,
        "margin": 90.0,
        "toss_up": False,
        "large": False,
        "matched_pixels": 1200,
        "box_pixels": 1200,
        "unknown_pixels": 0,
        "area_percent": 25.0,
        "crowding": 0.0,
        "hidden_by": [],
        "lossy": False,
        "distance": 12.5,
        "xyxy": [10.0, 10.0, 50.0, 40.0],
        "occluded": 3,
        "config": by_tags.digest,
    }


def test_decisions_are_computed_lazily_and_json_serialisable():
    outside = {"class": "car", "xyxy": [900, 0, 950, 20]}
    result = filter_frame(annotation(CAR, GHOST, outside), STREET)

    before = set(vars(result))
    again = json.loads(json.dumps(result.decisions, allow_nan=False))

    assert set(vars(result)) - before == {"decisions"}
    assert again == result.decisions
    reasons = [box["reason"] for box in again]
    assert reasons == ["visible", "no_visible_pixels", "outside_image"]
    assert (again[2]["xyxy"], again[2]["match_percent"]) == (None, None)


def test_box_without_a_segmentation_is_unmeasured():
    camera = {"width": 80, "height": 60}

    result = filter_frame(annotation(CAR, camera=camera), None)

    (decision,) = result.decisions
    assert (decision["verdict"], decision["reason"]) == (
        "unmeasured",
        "no_segmentation",
    )
    for key in ("match_percent", "threshold", "matched_pixels", "evidence"):
        assert decision[key] is None
    assert decision["xyxy"] == [10, 10, 50, 40]
    assert result.measured.segmentation is None
    assert filter_frame(annotation(camera=camera), None).decisions == []


def test_a_segmentation_may_be_a_file_raw_tags_or_an_array():
    tags = street_tags()

    results = [
        filter_frame(annotation(CAR, GHOST), segmentation)
        for segmentation in (png(painted(tags)), png(tags), tags)
    ]

    assert results[0].decisions == results[1].decisions == results[2].decisions
    reports = [result.measured.segmentation for result in results]
    assert [each and each["palette"] for each in reports] == ["carla-0.9.14"] * 3
    assert [each and each["encoding"] for each in reports] == ["palette", "raw", "raw"]
    numbers = np.where(street_tags() == 14, 100, street_tags()).astype(np.uint8)
    config = FilterConfig(tags={"100": "Car"})

    (decision,) = filter_frame(annotation(CAR), numbers, config).decisions

    assert decision["match_percent"] == 100.0


def test_blueprint_is_mapped_to_its_class_and_unknown_one_is_unmapped():
    boxes = [
        {"type_id": "vehicle.ford.ambulance", "xyxy": [10, 10, 50, 40]},
        {"type_id": "static.prop.bin", "xyxy": [10, 10, 50, 40]},
    ]

    van, prop = filter_frame(annotation(*boxes), STREET).decisions

    assert (van["class"], van["reason"]) == ("van", "visible")
    assert van["explanation"] == (
        "kept: 100 % of its pixels are Car or Truck, 10 % are needed"
    )
    assert (prop["class"], prop["reason"]) == ("static.prop.bin", "unmapped_class")


@pytest.mark.parametrize(
    ("more", "options", "words"),
    [
        ({}, FrameOptions(image_wh=(81, 60)), "81 x 60"),
        ({"camera": {"width": 80, "height": 61}}, FrameOptions(), "80 x 61"),
    ],
)
def test_images_of_different_sizes_are_refused(more, options, words):
    with pytest.raises(ImageSizeMismatch, match=words):
        filter_frame(annotation(CAR, **more), STREET, options=options)
    with pytest.raises(ImageSizeMismatch, match=words):
        filter_frame(annotation(CAR, **more), street_tags(), options=options)


@pytest.mark.parametrize(
    ("frame", "segmentation", "kind", "words"),
    [
        (annotation(CAR), None, "image_size_unknown", "found none of them"),
        ({"boxes": [CAR]}, street_tags(), "family_not_named", "cannot name its family"),
    ],
)
def test_frame_without_image_size_or_family_of_its_tags_is_refused(
    frame, segmentation, kind, words
):
    with pytest.raises((ImageSizeMismatch, SegmentationError), match=words) as caught:
        filter_frame(frame, segmentation)
    assert caught.value.kind == kind


def test_contradicting_palettes_raise_error_naming_both_sources():
    dataset = FrameOptions(dataset=SegmentationOptions(palette="carla-0.9.10"))
    config = FilterConfig(palette="carla-0.9.14")

    with pytest.raises(
        SegmentationError, match=r"the dataset says .* the configuration says"
    ):
        filter_frame(annotation(CAR), STREET, config, dataset)


def test_3d_box_decision_has_rectangles_edges_and_distance():
    origin = dict.fromkeys(("x", "y", "z", "pitch", "yaw", "roll"), 0)
    camera = {"width": 80, "height": 60, "fov": 90, "transform": origin}
    box3d = {"transform": {**origin, "x": 10}, "extent": {"x": 2, "y": 1, "z": 1}}

    boxes = [{"class": "car", "box3d": box3d}]
    result = filter_frame(annotation(*boxes, camera=camera), street_tags())

    (decision,) = result.decisions
    assert decision["distance"] == pytest.approx(10)
    assert decision["xyxy"] == decision["visible_xyxy"] == [35, 25, 45, 35]
    assert len(decision["edges"] or ()) == 12
    geometry = result.measured.geometry
    assert geometry.xyxy.tolist() == [[35, 25, 45, 35]]
    assert geometry.distance.tolist() == [pytest.approx(10)]
    assert (geometry.vertices.min(), geometry.vertices.max()) == (-1, 12)


@pytest.mark.parametrize("form", ["raw", "colours", "no segmentation"])
@pytest.mark.parametrize("swapped", [False, True])
def test_instances_and_lidar_of_a_changed_carla_have_its_numbers(form, swapped):
    tags, _, ids = scene()
    numbers = np.where(tags == CAR_TAG, 100, tags).astype(np.uint8)
    segmentation = {
        "raw": png(numbers),
        "colours": png(painted(tags)),
        "no segmentation": None,
    }[form]
    points = [[8.0, 0.0, 0.0, 1.0, 7.0, tag] for tag in [100] * 6 + [CAR_TAG, 300]]
    contents = {
        "instances": instance_png(numbers, ids + 256 * 200, swapped=swapped),
        "lidar": npy(np.array(points)),
    }
    options = FrameOptions(image_wh=(WIDTH, HEIGHT), sensors=contents)
    # In the first form, Car's own number is none any more.
    tags_of = {"100": "Car", str(CAR_TAG): "Fence"} if form == "raw" else {"100": "Car"}

    def reasons(evidence):
        config = FilterConfig(evidence=evidence, tags=tags_of)
        result = filter_frame(ANNOTATION, segmentation, config, options)
        return [box["reason"] for box in result.decisions], result.measured.evidence

    instances, _ = reasons("instance")
    lidar, evidence = reasons("lidar")

    assert instances == ["visible", "hidden_by_instance"]
    assert lidar == ["visible", "too_few_lidar_points"]
    assert evidence.channels is not None
    assert evidence.channels.lidar_points.tolist() == [7 - (form == "raw"), 0]
