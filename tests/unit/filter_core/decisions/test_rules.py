"""The rules of deciding: the reason given, the threshold applied, close decisions."""

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.decisions.rules import decide
from filter_core.verdicts import Reason, Verdict
from tests.support.evidence import evidence_of


def test_carlasimu_match_over_100_percent_is_compared_before_capping():
    box = {"match_percent": 104.0}
    config = FilterConfig(profile="carlasimu", threshold_small_box=100)

    decisions = decide(evidence_of([box]), config)

    assert decisions.reason[0] == Reason.VISIBLE
    assert decisions.margin[0] == 0
    nothing = decide(evidence_of([], class_names=()), config)
    assert (len(nothing), nothing.count(Verdict.KEPT)) == (0, 0)


@pytest.mark.parametrize(
    ("distance", "reason"),
    [(4.99, "out_of_range"), (5, "visible"), (np.nan, "visible")],
)
def test_smallest_distance_is_inclusive(distance, reason):
    decisions = decide(
        evidence_of([{"distance": distance}]), FilterConfig(min_distance=5)
    )

    assert Reason(decisions.reason[0]).label == reason
