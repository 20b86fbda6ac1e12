"""The rules of deciding: the reason given, the threshold applied, close decisions."""

from __future__ import annotations

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.decisions.rules import decide
from filter_core.verdicts import Reason, Verdict
from tests.support.evidence import evidence_of


def reason_of(box, **config):
    return Reason(decide(evidence_of([box]), FilterConfig(**config)).reason[0]).label


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


def test_no_boxes_give_no_decisions():
    decisions = decide(evidence_of([], class_names=()), FilterConfig())

    assert len(decisions) == 0
    assert decisions.count(Verdict.KEPT) == 0


def test_decide_needs_neither_rectangles_nor_histograms():
    evidence = evidence_of([{}, {"match_percent": 1}])

    assert evidence.xyxy is None
    assert decide(evidence, FilterConfig()).count(Verdict.KEPT) == 1
