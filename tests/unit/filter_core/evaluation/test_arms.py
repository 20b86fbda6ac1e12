"""Arms of an experiment: which boxes they label, and what is wrong with the labels."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.errors import ConfigError
from filter_core.evaluation.arms import ARMS, Arm, LabelNoise, truth_of_pixels
from filter_core.formats.reading import GivenAnswer
from filter_core.local import (
    ArmsTask,
    KnownBox,
    LabelledFrame,
    label_sources,
    read_box_truth,
)
from tests.support.sensors import ANNOTATION, cube, scene_source

EVERY_ARM = tuple(map(Arm, ARMS))
KNOWN = {"a": {"217": KnownBox(-1, 4), "218": KnownBox(1, 12)}}
# Seen; hidden behind it; behind the camera, where the corners are mirrored into view.
BOXES = [cube("217", 10.0), cube("218", 40.0), cube("219", -12.0)]


@pytest.fixture
def source(tmp_path):
    return scene_source(tmp_path, boxes=BOXES)


def labelled(source, **task):
    (frame,) = label_sources([source], ArmsTask(EVERY_ARM, **task))
    assert isinstance(frame, LabelledFrame)
    return frame.boxes


def test_arms_label_what_their_filter_keeps(source):
    boxes = labelled(source)

    assert boxes.truth.tolist() == [1, 0, 0]
    kept = {name: labelled.tolist() for name, labelled in boxes.labelled.items()}
    drawn = kept.pop("random")
    every = {"raw": [True, True, True], "clipped": [True, True, False]}
    by_tags, exact = [True, True, False], [True, False, False]
    others = ("ordered", "depth", "instance", "auto", "perfect")
    assert kept == every | dict.fromkeys(others, exact) | {
        "paper": by_tags,
        "carlasimu": [*by_tags[:2], kept["carlasimu"][2]],
    }
    assert sum(drawn) == 1
    assert not drawn[2]
    # The control draws the same boxes each time.
    assert labelled(source).labelled["random"].tolist() == drawn


def test_raw_rectangles_are_those_of_all_eight_corners_and_others_exact(source):
    boxes = labelled(source)

    assert np.isnan(boxes.rectangles("clipped")[:2]).any() == False  # noqa: E712  # of numpy
    assert boxes.rectangles("raw")[:2] == pytest.approx(boxes.xyxy[:2])
    assert np.isnan(boxes.xyxy[2]).all()
    assert boxes.rectangles("auto")[2] == pytest.approx(boxes.raw_xyxy[2])


def test_frame_without_an_image_is_labelled_too(source):
    boxes = [{"id": "1", "class": "car", "xyxy": [61, 41, 99, 79]}]
    annotation = {**ANNOTATION, "boxes": boxes, "camera": None}
    flat = replace(source, annotation=annotation)

    (frame,) = label_sources([flat], ArmsTask((Arm("raw"), Arm("ordered"))))

    assert isinstance(frame, LabelledFrame)
    assert frame.boxes.labelled["raw"].tolist() == [True]


@pytest.mark.parametrize(
    ("verdicts", "task", "truth"),
    [
        (["keep", "reject"], "reviews", [1, 0, 0]),
        ([], "reviews", [-1, -1, 0]),  # nobody has answered
        (["keep", "reject"], KNOWN, [-1, 1, 0]),
    ],
)
def test_truth_comes_from_answers_or_from_a_file(source, verdicts, task, truth):
    answers = [
        GivenAnswer(box, verdict, "ada", "", "2026-01-01T00:00:00Z")
        for box, verdict in zip(("217", "218"), verdicts, strict=False)
    ]

    boxes = labelled(replace(source, answers=answers), truth=task)
    assert boxes.truth.tolist() == truth


def test_truth_file_tells_pixels_where_it_has_them(tmp_path):
    path = tmp_path / "truth.jsonl"
    path.write_text(
        '{"key": "a", "id": 1, "visible": true, "visible_pixels": 3}\n'
        '{"key": "a", "id": 2, "visible": true}\n'
        '{"key": "a", "id": 3, "visible": false, "visible_pixels": 0}\n'
    )

    assert read_box_truth(path, 10) == {"a": {"1": (-1, 3), "2": (1, -1), "3": (0, 0)}}
    doubtful = truth_of_pixels(np.array([0, 1, 9, 10, -1]), 10)
    assert doubtful.truth.tolist() == [0, -1, -1, 1, -1]


def test_label_noise_counts_ghosts_and_lost_objects(source):
    noise = LabelNoise(ARMS)
    truth = {"a": {"217": KnownBox(0, 0), "218": KnownBox(1, 50)}}

    noise.add(labelled(source))
    noise.add(labelled(source, truth=truth))

    table: dict[str, Any] = {**noise.as_dict()}
    counts = {name: table[name] for name in ("frames", "objects", "ghosts", "doubtful")}
    assert counts == {"frames": 2, "objects": 2, "ghosts": 4, "doubtful": 0}
    depth = table["arms"]["depth"]
    keys = ("labels", "kept_hidden", "rejected_visible")
    assert [depth[key] for key in keys] == [2, 1, 1]
    assert table["arms"]["raw"]["kept_hidden"] == 4
    by_class = depth["by_class"]["car"]
    assert (by_class["kept_visible"], by_class["kept_hidden"]) == (1, 1)
    groups = {group["pixels"]: group["labelled"] for group in depth["by_pixels"]}
    assert (groups["100+"], groups["0"]) == (1, 1)


def test_evidence_that_is_not_there_is_counted(source):
    without = replace(source, others={})
    noise = LabelNoise(["depth", "ordered"])
    truth = {"a": {"217": KnownBox(1, 99)}}

    noise.add(labelled(without, truth=truth))

    arms = noise.as_dict()["arms"]
    counts = [arms[name]["without_evidence"] for name in ("depth", "ordered")]
    assert counts == [2, 0]


@pytest.mark.parametrize(
    ("name", "evidence", "pixels"),
    [
        ("paper", "semantic", 1),
        ("carlasimu", "semantic", 1),
        ("ordered", "ordered", 1),
        ("ordered@3", "ordered", 3),
        ("auto", "auto", 10),
        ("random", "auto", 10),
    ],
)
def test_configuration_of_an_arm(name, evidence, pixels):
    config = Arm.named(name).config(FilterConfig())

    assert config is not None
    assert (config.evidence, config.min_visible_pixels) == (evidence, pixels)
    assert Arm.named(name).name == name


@pytest.mark.parametrize("name", ["lidar", "raw@3", "ordered@", "ordered@x", ""])
def test_unknown_arm_is_an_error_that_lists_them(name):
    with pytest.raises(ConfigError, match="expected raw, clipped, paper"):
        Arm.named(name)
