"""The rules of deciding: the reason given, the threshold applied, close decisions."""

from __future__ import annotations

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.decisions.rules import decide
from filter_core.evidence_numbers import BoxState
from filter_core.verdicts import Reason, Verdict
from tests.support.evidence import evidence_of


def reason_of(box, **config):
    return Reason(decide(evidence_of([box]), FilterConfig(**config)).reason[0]).label


def test_first_matching_rule_gives_the_reason():
    everything = {
        "state": BoxState.OUTSIDE_IMAGE,
        "distance": 500,
        "accept_mask": 0,
        "measured": False,
        "matched_pixels": 0,
        "area_percent": 90,
        "match_percent": 1,
    }
    faults = [
        ("outside_image", "state"),
        ("out_of_range", "distance"),
        ("unmapped_class", "accept_mask"),
        ("no_segmentation", "measured"),
        ("no_visible_pixels", "matched_pixels"),
        ("large_below_threshold", "area_percent"),
        ("below_threshold", "match_percent"),
    ]

    for reason, key in faults:
        assert reason_of(everything, max_distance=100) == reason
        del everything[key]

    assert reason_of(everything, max_distance=100) == "visible"


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        (BoxState.OUTSIDE_IMAGE, "outside_image"),
        (BoxState.COVERS_IMAGE, "covers_image"),
        (BoxState.DEGENERATE, "degenerate"),
    ],
)
def test_invalid_box_state_precedes_missing_segmentation(state, reason):
    assert reason_of({"state": state, "measured": False}) == reason


@pytest.mark.parametrize(
    ("match", "area", "profile", "reason"),
    [
        (9.99, 1, "paper", "below_threshold"),
        (10, 1, "paper", "visible"),
        (10, 1, "carlasimu", "below_threshold"),
        (10.01, 1, "carlasimu", "visible"),
        (49.99, 70, "paper", "visible"),
        (49.99, 70.01, "paper", "large_below_threshold"),
        (50, 70.01, "paper", "visible"),
        (50, 70, "carlasimu", "large_below_threshold"),
        (50, 69.99, "carlasimu", "visible"),
        (50.01, 70, "carlasimu", "visible"),
    ],
)
def test_reason_of_match_or_area_at_its_threshold_by_profile(
    match, area, profile, reason
):
    box = {"match_percent": match, "area_percent": area}

    assert reason_of(box, profile=profile) == reason


def test_profile_carlasimu_tests_large_boxes_by_both_thresholds():
    box = {"match_percent": 40, "area_percent": 90}
    config = {"threshold_small_box": 60, "threshold_big_box": 20}

    assert reason_of(box, **config) == "visible"
    assert reason_of(box, profile="carlasimu", **config) == "below_threshold"


@pytest.mark.parametrize(
    ("match", "profile", "small", "threshold"),
    [
        (70, "paper", 60, 20),
        (70, "carlasimu", 60, 60),
        (70, "carlasimu", 10, 20),
        (40, "carlasimu", 60, 60),
        (15, "carlasimu", 60, 20),
        (15, "paper", 60, 20),
    ],
)
def test_threshold_of_a_large_box_is_the_one_that_decided(
    match, profile, small, threshold
):
    box = {"match_percent": match, "area_percent": 90}
    config = FilterConfig(
        profile=profile, threshold_small_box=small, threshold_big_box=20
    )

    decisions = decide(evidence_of([box]), config)

    assert decisions.threshold.tolist() == [threshold]


def test_carlasimu_match_over_100_percent_is_compared_before_capping():
    box = {"match_percent": 104.0}
    config = FilterConfig(profile="carlasimu", threshold_small_box=100)

    decisions = decide(evidence_of([box]), config)

    assert decisions.reason[0] == Reason.VISIBLE
    assert decisions.margin[0] == 0


@pytest.mark.parametrize(
    ("distance", "reason"),
    [
        (4.99, "out_of_range"),
        (5, "visible"),
        (80, "visible"),
        (80.01, "out_of_range"),
        (np.nan, "visible"),
    ],
)
def test_min_and_max_distance_are_inclusive(distance, reason):
    box = {"distance": distance}

    assert reason_of(box, min_distance=5, max_distance=80) == reason


@pytest.mark.parametrize(("pixels", "reason"), [(2, "no_visible_pixels"), (3, None)])
def test_min_visible_pixels_is_inclusive(pixels, reason):
    box = {"matched_pixels": pixels, "match_percent": 30}

    assert reason_of(box, min_visible_pixels=3) == (reason or "visible")


def test_each_class_has_its_own_thresholds():
    config = FilterConfig.from_mapping(
        {
            "classes": {
                "street_light": {"threshold_small_box": 2},
                "van": {"size_big_box": 30, "threshold_big_box": 60},
            }
        }
    )
    names = ("car", "street_light", "van")
    boxes = [
        {"class_index": index, "match_percent": 5, "area_percent": area}
        for index, area in enumerate((1, 1, 40))
    ]

    decisions = decide(evidence_of(boxes, names), config)

    assert decisions.threshold.tolist() == [10, 2, 60]
    assert decisions.margin.tolist() == [-5, 3, -55]
    assert decisions.large.tolist() == [False, False, True]
    labels = [Reason(code).label for code in decisions.reason]
    assert labels == ["below_threshold", "visible", "large_below_threshold"]


def test_threshold_and_margin_are_nan_where_an_earlier_rule_decided():
    boxes = [
        {"state": BoxState.DEGENERATE},
        {"accept_mask": 0},
        {"measured": False, "match_percent": np.nan},
        {"matched_pixels": 0, "match_percent": 0.0, "area_percent": 90},
    ]

    decisions = decide(evidence_of(boxes), FilterConfig())

    assert np.isnan(decisions.threshold).all()
    assert np.isnan(decisions.margin).all()
    assert not decisions.toss_up.any()
    assert not decisions.large.any()


@pytest.mark.parametrize(
    ("matched", "pixels", "toss_up"),
    [
        (9, 100, True),
        (5, 100, True),
        (4, 100, False),
        (90, 1000, True),
        (80, 1000, False),
    ],
)
def test_few_pixels_near_the_threshold_are_a_toss_up(matched, pixels, toss_up):
    box = {
        "matched_pixels": matched,
        "box_pixels": pixels,
        "match_percent": 100 * matched / pixels,
    }

    config = FilterConfig(profile="paper")

    assert decide(evidence_of([box]), config).toss_up[0] == toss_up


def test_no_boxes_give_no_decisions():
    decisions = decide(evidence_of([], class_names=()), FilterConfig())

    assert len(decisions) == 0
    assert decisions.count(Verdict.KEPT) == 0


def test_decide_needs_neither_rectangles_nor_histograms():
    evidence = evidence_of([{}, {"match_percent": 1}])

    assert evidence.xyxy is None
    assert decide(evidence, FilterConfig()).count(Verdict.KEPT) == 1
