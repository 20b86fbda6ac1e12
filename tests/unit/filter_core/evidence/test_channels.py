"""Frames decided by depth, instances, order of distance and LiDAR."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from filter_core.arrays import NOT_MEASURED
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.decisions.record import Decision
from filter_core.errors import ImageError, ImageTooLarge
from filter_core.evidence.channels import Sensors, measure_evidence
from filter_core.evidence.depth import read_depth
from filter_core.evidence_kinds import STRONGEST_FIRST, EvidenceChoice
from filter_core.evidence_numbers import ChannelNumbers, number_columns
from filter_core.formats.registry import read_source
from filter_core.frame_boxes import FrameBoxes
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from filter_core.local import filter_source
from filter_core.pipeline import FrameOptions, filter_frame, read_and_measure
from filter_core.segmentation.reading import segmentation_from_tags
from tests.support.lidar import npy
from tests.support.pictures import jpeg, painted, pixels_of, png
from tests.support.sensors import (
    ANNOTATION,
    CAR,
    FAR,
    HEIGHT,
    NEAR,
    ROAD,
    WIDTH,
    cube,
    depth_file,
    depth_png,
    instance_file,
    instance_png,
    scene,
    street_metres,
)
from tests.support.shared_data import shared


def decided(evidence: EvidenceChoice, **contents: bytes) -> list[Decision]:
    tags, _, _ = scene()
    options = FrameOptions(sensors=contents)
    return filter_frame(
        ANNOTATION, tags, FilterConfig(evidence=evidence), options
    ).decisions


FILES = {"instances": instance_file(), "depth": depth_file()}


@pytest.mark.parametrize(
    ("evidence", "explanation"),
    [
        ("ordered", "its Car pixels belong to nearer boxes, above all car 217"),
        ("depth", "all Car pixels here are 30 m nearer than the box"),
        ("depth_center", "what is seen at its centre is 30 m nearer than the box"),
        ("instance", "no instance in the image belongs to it"),
        ("auto", "no instance in the image belongs to it"),
    ],
)
def test_each_channel_rejects_the_hidden_car(evidence, explanation):
    near, far = decided(evidence, **FILES)

    assert near["verdict"] == "kept"
    assert far["explanation"] == f"rejected: {explanation}"
    assert far["evidence"] == ("instance" if evidence == "auto" else evidence)
    assert far["threshold"] is None


def test_decision_has_the_numbers_of_its_channel():
    near, far = decided("instance", **FILES)
    assert near["tight_xyxy"] == [61.0, 41.0, 99.0, 79.0]
    assert near["visible_pixels"] == 38 * 38
    assert (far["tight_xyxy"], far["visible_pixels"]) == (None, 0)
    assert near["truncated"] == pytest.approx(0.0)

    near, far = decided("depth", **FILES)
    assert (near["occluded"], far["occluded"]) == (0, 2)

    near, far = decided("ordered")
    assert (near["explained_by"], far["explained_by"]) == (None, "217")

    near, far = decided("semantic")
    assert (near["verdict"], far["verdict"]) == ("kept", "kept")
    assert near["occluded"] == 3


def test_pixels_decide_as_the_files_that_have_them_and_other_arrays_are_refused():
    pixels = {name: pixels_of(content)[..., :3] for name, content in FILES.items()}
    tags, _, _ = scene()

    result = filter_frame(ANNOTATION, tags, options=FrameOptions(pixels=pixels))

    assert result.decisions == decided("auto", **FILES)
    for name, picture in pixels.items():
        wide: Any = picture.astype(np.uint16)
        for wrong in (picture[..., 0], wide):
            options = FrameOptions(pixels={name: wrong})
            with pytest.raises(ImageError, match=f"{name}: pixels: expected"):
                filter_frame(ANNOTATION, tags, options=options)


def test_file_may_be_missing_or_not_needed_and_a_segmentation_may_be_missing():
    near, far = decided("depth")
    assert (near["evidence"], far["evidence"]) == ("semantic", "semantic")
    assert far["explanation"].startswith("kept: ")
    assert decided("semantic", depth=b"no image at all")[0]["verdict"] == "kept"

    options = FrameOptions(
        image_wh=(WIDTH, HEIGHT), sensors={"instances": instance_file()}
    )
    result = filter_frame(ANNOTATION, None, FilterConfig(evidence="instance"), options)
    assert [box["verdict"] for box in result.decisions] == ["kept", "rejected"]


COARSE = png(np.zeros((HEIGHT, WIDTH), np.uint8))


def measured_notes(**contents: bytes) -> tuple[str, ...]:
    """The notes on sensors, which are also in the report of the segmentation."""
    options, config = FrameOptions(sensors=contents), FilterConfig(evidence="auto")
    measured = filter_frame(ANNOTATION, scene()[0], config, options).measured
    report: Any = measured.segmentation
    count = len(measured.notes)
    assert count == 0 or report["notes"][-count:] == list(measured.notes)
    return measured.notes


STEPS = (street_metres(HEIGHT, WIDTH) / 1000 * 255).astype(np.uint8)


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(png(np.dstack([STEPS] * 3)), id="grey in three channels"),
        pytest.param(png(STEPS), id="grey"),
        pytest.param(jpeg(np.dstack([STEPS] * 3)), id="jpeg"),
        pytest.param(png(STEPS.astype(np.uint16)), id="metres of 16 bits"),
        pytest.param(instance_file(), id="instances"),
        pytest.param(png(painted(scene()[0])), id="segmentation"),
    ],
)
def test_depth_that_is_not_understood_decides_nothing_and_is_noted(content):
    without = decided("auto")

    assert decided("auto", depth=content) == without
    (note,) = measured_notes(depth=content)
    assert note.startswith("depth is not used as evidence: the depth image: ")
    with pytest.raises(ImageError):
        decided("depth", depth=content)


def test_swapped_depth_and_instances_decide_as_others_and_are_noted():
    tags, metres, ids = scene()
    depth = png(pixels_of(depth_png(metres)), "rgb")
    instances = instance_png(tags, ids, swapped=True)

    assert decided("auto", depth=depth) == decided("auto", depth=depth_file())
    assert decided("auto", instances=instances) == decided(
        "auto", instances=instance_file()
    )
    assert measured_notes(depth=depth, instances=instances) == (
        "red and blue are swapped in the instance image; read as bgr",
        "red and blue are swapped in the depth image; read as carla-bgr",
    )
    assert measured_notes(depth=depth_file(), instances=instance_file()) == ()


def test_millimetres_of_16_bits_decide_as_raw_depth_and_are_noted():
    # What is farther wraps around, as in files that were written without a check.
    wide = np.rint(np.where(scene()[1] < 60, scene()[1], 80) * 1000).astype(np.int64)
    depth = png((wide & 0xFFFF).astype(np.uint16))
    boxes = [cube("217", NEAR), cube("218", FAR), cube("219", 90)]
    visible_only = {**ANNOTATION, "boxes": boxes[:1]}
    options = FrameOptions(sensors={"depth": depth})

    unnamed = filter_frame(
        visible_only, scene()[0], FilterConfig(evidence="auto"), options
    )
    named = filter_frame(
        {**ANNOTATION, "boxes": boxes},
        scene()[0],
        FilterConfig(evidence="depth", depth_encoding="millimetres16"),
        options,
    )

    assert "read as millimetres16" in unnamed.measured.notes[0]
    assert unnamed.decisions[0]["evidence"] == "depth"
    assert unnamed.decisions[0]["verdict"] == "kept"
    assert [(box["verdict"], box["evidence"]) for box in named.decisions] == [
        ("kept", "depth"),
        ("rejected", "depth"),
        ("kept", "semantic"),
    ]


@pytest.mark.parametrize(
    ("needed", "boxes", "explanation"),
    [
        (1, [FAR], "kept: 1 of its Car pixels belongs to no nearer box"),
        (2, [FAR], "rejected: only 1 of its pixels is Car, 2 are needed"),
        (1, [NEAR, FAR],
         "rejected: its Car pixels belong to nearer boxes, above all car 0"),
    ],
)  # fmt: skip
def test_ordered_decision_of_a_box_with_one_visible_pixel(needed, boxes, explanation):
    tags = np.full((HEIGHT, WIDTH), ROAD, np.uint8)
    tags[HEIGHT // 2, WIDTH // 2] = CAR
    cubes = [cube(str(place), distance) for place, distance in enumerate(boxes)]
    config = FilterConfig(evidence="ordered", min_visible_pixels=needed)

    result = filter_frame({**ANNOTATION, "boxes": cubes}, tags, config)

    assert result.decisions[-1]["explanation"] == explanation


def test_too_coarse_depth_refuses_the_frame_except_where_others_are_measured():
    with pytest.raises(ImageError, match=r"3\.9 m"):
        decided("depth", depth=COARSE)
    assert decided("auto", depth=COARSE)[1]["evidence"] == "ordered"

    options = FrameOptions(sensors={"depth": COARSE})
    configs = [
        FilterConfig(evidence=name).measuring().with_channels(STRONGEST_FIRST)
        for name in ("auto", "depth")
    ]
    first, second = (
        read_and_measure(ANNOTATION, scene()[0], config, options).evidence.channels
        for config in configs
    )
    assert configs[0].digest == configs[1].digest
    assert first is not None
    assert second is not None
    assert first.owned_pixels.tolist() == second.owned_pixels.tolist()
    for numbers in (first, second):
        assert (numbers.depth_pixels == NOT_MEASURED).all()


SEGMENTED = segmentation_from_tags(scene()[0], "carla-0.9.14")


def cars(xyxy, distance):
    """Boxes of cars without an annotation."""
    accept = {"car": 1 << CAR}
    return FrameBoxes.of(xyxy, ["car"] * len(xyxy), accept, (WIDTH, HEIGHT), distance)


def test_boxes_can_be_measured_without_an_annotation():
    xyxy = [[60, 40, 100, 80], [65, 45, 95, 75], [0, 0, 9, 9]]
    sensors = Sensors(segmentation=SEGMENTED, contents=FILES)
    config = MeasureConfig(channels=("ordered", "depth", "instance"))

    evidence, _ = measure_evidence(cars(xyxy, [NEAR, FAR, np.nan]), sensors, config)

    channels = evidence.channels
    assert channels is not None
    assert evidence.matched_pixels.tolist() == [38 * 38, 30 * 30, 0]
    assert channels.owned_pixels.tolist() == [38 * 38, 0, NOT_MEASURED]
    assert channels.explained_by.tolist() == [NOT_MEASURED, 0, NOT_MEASURED]
    assert channels.instance_pixels.tolist() == [38 * 38, 0, 0]
    # Depth needs a camera and corners: there are none.
    assert channels.depth_pixels.tolist() == [NOT_MEASURED] * 3
    # Rectangles are clipped to the image.
    tags = np.full((HEIGHT, WIDTH), CAR, np.uint8)
    sensors = Sensors(segmentation=segmentation_from_tags(tags, "carla-0.9.14"))
    config = MeasureConfig(channels=("ordered",))
    clipped = measure_evidence(cars([[-40, -40, 20, 10]], [9]), sensors, config)[
        0
    ].channels
    assert clipped is not None
    assert clipped.owned_pixels.tolist() == [20 * 10]


def test_boxes_without_corners_have_no_depth_or_lidar_numbers():
    point = npy(np.array([[9.0, 0.0, 0.0, 1.0, 7.0, CAR]]))
    sensors = Sensors(
        segmentation=SEGMENTED,
        camera=Camera.from_fov(WIDTH, HEIGHT, 90, Transform()),
        lidar=Transform(),
        contents={"depth": depth_file(), "lidar": point},
    )
    config = MeasureConfig(channels=("ordered", "depth", "depth_center", "lidar"))
    boxes = cars([[60, 40, 100, 80]] * 2, [9, 9])

    channels = measure_evidence(boxes, sensors, config)[0].channels

    assert channels is not None
    assert channels.explained_by.tolist() == [NOT_MEASURED, 0]
    # Depth and LiDAR need corners: no box has any.
    assert channels.depth_pixels.tolist() == [NOT_MEASURED] * 2
    assert np.isnan(channels.center_gap).all()
    assert channels.lidar_points.tolist() == [NOT_MEASURED] * 2


@pytest.mark.parametrize("kind", ["segmentation", "depth", "instances"])
def test_image_larger_than_max_side_is_refused(kind):
    tags, _, _ = scene()
    segmentation = png(np.dstack([tags] * 3)) if kind == "segmentation" else tags
    contents = {kind: FILES[kind]} if kind in FILES else {}
    options = FrameOptions(sensors=contents, max_side=WIDTH - 1)

    with pytest.raises(ImageTooLarge, match=f"may exceed {WIDTH - 1}"):
        filter_frame(ANNOTATION, segmentation, FilterConfig(evidence="auto"), options)


def test_absent_fills_every_column_with_its_missing_value():
    channels = ChannelNumbers.absent(2)

    for name, column in number_columns(ChannelNumbers).items():
        numbers = getattr(channels, name)
        assert numbers.shape == (2, *column.shape)
        assert numbers.dtype == column.dtype
        np.testing.assert_equal(numbers, np.full_like(numbers, column.missing))


def test_depth_in_another_unit_is_no_evidence(tmp_path):
    """All pixels are ten times as far away as CARLA would have stored them.

    The case has a visible object N before a hidden one, G, and a free one, F.
    """
    (source,) = read_source(shared("cases/02-depth-encodings/raw"))
    steps = read_depth(source.others["depth"].read_bytes()).steps(np.s_[:, :])
    steps = np.minimum(steps.astype(np.int64) * 10, (1 << 24) - 1)
    colors = np.dstack([steps & 255, steps >> 8 & 255, steps >> 16]).astype(np.uint8)
    (tmp_path / "depth.png").write_bytes(png(colors))
    scaled = replace(source, others={"depth": tmp_path / "depth.png"})

    (outcome,) = filter_source([scaled], FilterConfig(evidence="auto"), workers=1)

    assert outcome.decisions is not None, outcome.error
    assert {box["evidence"] for box in outcome.decisions} == {"ordered"}
    verdicts = {box["id"]: box["verdict"] for box in outcome.decisions}
    assert verdicts == {"N": "kept", "G": "rejected", "F": "kept"}
    assert "behind each of the" in outcome.notes[0]
