"""Profile `carlasimu` says what the code that the paper's authors published says."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.pipeline import filter_frame
from tests.support.shared_data import shared
from tests.support.sources import CHECKOUT

SMALL = CHECKOUT / "tests" / "data" / "published_verdicts"


def check_cases(folder: Path) -> int:
    """Every verdict and correction in the folder; the number of cases."""
    cases = json.loads((folder / "cases.json").read_text())["cases"]
    groups = defaultdict(list)
    for case in cases:
        thresholds = ("threshold_small_box", "size_big_box", "threshold_big_box")
        name = (case["mask"], *(case[key] for key in thresholds))
        groups[name].append(case)

    for (mask, small, size, big), group in groups.items():
        config = FilterConfig(
            profile="carlasimu",
            palette="paper-table1",
            threshold_small_box=small,
            size_big_box=size,
            threshold_big_box=big,
        )
        boxes = [{"class": one["class"], "xyxy": one["box_xyxy"]} for one in group]
        content = (folder / "masks" / mask).read_bytes()

        result = filter_frame({"boxes": boxes}, content, config)

        for case, decision in zip(group, result.decisions, strict=True):
            assert (decision["verdict"] == "kept") is case["kept"], case
            assert_same_rectangle(decision, case)
    return len(cases)


def assert_same_rectangle(decision, case):
    if case["corrected"] is None:
        dropped = ("outside_image", "degenerate", "covers_image")
        assert decision["reason"] in dropped, case
    else:
        np.testing.assert_array_equal(decision["xyxy"], case["corrected"])


def test_all_published_verdicts_and_corrections_agree():
    assert check_cases(shared("oracles/published_verdicts")) == 1090


def test_selected_verdicts_at_exact_thresholds_agree():
    assert check_cases(SMALL) >= 40


@pytest.mark.parametrize("kind", ["vehicle.tesla.model3", "walker.pedestrian.0001"])
def test_blueprint_gets_the_same_decision_as_its_class(kind):
    name = {"vehicle.tesla.model3": "car", "walker.pedestrian.0001": "walker"}[kind]
    config = FilterConfig(profile="carlasimu", palette="paper-table1")
    content = (SMALL / "masks" / "mask_003.png").read_bytes()
    rectangle = [20, 20, 90, 90]

    by_type, by_class = (
        filter_frame({"boxes": [{**box, "xyxy": rectangle}]}, content, config)
        for box in ({"type_id": kind}, {"class": name})
    )

    assert by_type.decisions == by_class.decisions
