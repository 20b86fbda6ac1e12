"""The rules of deciding: the reason given, the threshold applied, close decisions."""

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


def test_carlasimu_match_over_100_percent_is_compared_before_capping():
    box = {"match_percent": 104.0}
    config = FilterConfig(profile="carlasimu", threshold_small_box=100)

    decisions = decide(evidence_of([box]), config)

    assert decisions.reason[0] == Reason.VISIBLE
    assert decisions.margin[0] == 0


@pytest.mark.parametrize(
    ("box", "reason"),
    [
        ({"distance": 4.99}, "out_of_range"),
        ({"distance": 5}, "visible"),
        ({"distance": 80}, "visible"),
        ({"distance": 80.01}, "out_of_range"),
        ({"distance": np.nan}, "visible"),
        ({"matched_pixels": 2, "match_percent": 30}, "no_visible_pixels"),
        ({"matched_pixels": 3, "match_percent": 30}, "visible"),
    ],
)
def test_limits_of_distance_and_visible_pixels_are_inclusive(box, reason):
    limits = {"min_distance": 5, "max_distance": 80, "min_visible_pixels": 3}

    assert reason_of(box, **limits) == reason


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


def test_decide_needs_neither_boxes_nor_rectangles():
    nothing = decide(evidence_of([], class_names=()), FilterConfig())
    evidence = evidence_of([{}, {"match_percent": 1}])

    assert (len(nothing), nothing.count(Verdict.KEPT)) == (0, 0)
    assert evidence.xyxy is None
    assert decide(evidence, FilterConfig()).count(Verdict.KEPT) == 1
