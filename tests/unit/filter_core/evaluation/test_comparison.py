"""Evaluation: the verdicts of each channel are compared with the truth of each box."""

import numpy as np

from filter_core.config.filter import FilterConfig
from filter_core.evaluation.comparison import Evaluation
from filter_core.evidence_kinds import CHANNELS
from filter_core.pipeline import FrameOptions, filter_frame, read_and_measure
from tests.support.sensors import ANNOTATION, depth_png, instance_png, scene

TRUTH = np.array([True, False])


def measured(*kinds):
    tags, metres, ids = scene()
    contents = {"depth": depth_png(metres), "instances": instance_png(tags, ids)}
    files = {kind: contents[kind] for kind in kinds}
    config = FilterConfig().measuring().with_channels(CHANNELS)
    options = FrameOptions(sensors=files)
    return read_and_measure(ANNOTATION, tags, config, options).evidence


def test_evaluation_scores_every_channel_on_the_same_boxes():
    evaluation = Evaluation(FilterConfig())

    for _ in range(3):
        evaluation.add(measured("depth", "instances"), TRUTH)

    table = evaluation.as_dict()
    assert (table["frames"], table["boxes"]) == (3, 6)
    ghosts = {name: row["kept_hidden"] for name, row in table["channels"].items()}
    assert ghosts == {
        "semantic": 3,
        "ordered": 0,
        "depth": 0,
        "depth_center": 0,
        "instance": 0,
        "lidar": 3,
    }
    f1 = table["channels"]["depth"]["f1"]
    assert f1 is not None
    assert f1["value"] == 1.0


def test_scores_are_grouped_and_judged_is_zero_without_measurements():
    evaluation = Evaluation(FilterConfig(), ("semantic", "depth", "ordered"))

    evaluation.add(measured(), TRUTH)

    judged = {name: scores.judged for name, scores in evaluation.scores.items()}
    assert judged == {"semantic": 2, "depth": 0, "ordered": 2}
    semantic = evaluation.as_dict()["channels"]["semantic"]
    assert semantic["by_class"]["car"]["kept_hidden"] == 1
    assert [band["band"] for band in semantic["by_distance"]] == ["0-50"]


def test_box_of_an_unknown_class_or_without_measurement_is_not_counted():
    boxes = [{**box, "class": "alien"} for box in ANNOTATION["boxes"]]
    alien = filter_frame({**ANNOTATION, "boxes": boxes}, scene()[0])
    unseen = filter_frame(ANNOTATION, None, options=FrameOptions(image_wh=(160, 120)))

    for result in (alien, unseen):
        evaluation = Evaluation(FilterConfig(), ("semantic",))
        evaluation.add(result.measured.evidence, TRUTH)
        assert evaluation.scores["semantic"].judged == 0
    assert evaluation.scores["semantic"].total.boxes == 0
