"""Profile `carlasimu` says what the code that the paper's authors published says."""

import json
from collections import defaultdict
from pathlib import Path

import numpy as np

from filter_core.config.file import load_config
from filter_core.config.filter import FilterConfig
from filter_core.pipeline import filter_frame
from tests.support.pictures import png
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
        boxes = [{"class": box["class"], "xyxy": box["box_xyxy"]} for box in group]
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


# Metres ahead of the camera and beside it; its `min_distance` is 1 m ahead.
PLACES = {
    (50.1, 0): "visible", (80, 0): "visible", (150, 0): "visible", (200, 0): "visible",
    (4, 3): "visible", (0.9, 3): "out_of_range", (0.9, 40): "out_of_range",
}  # fmt: skip


def test_authors_own_configuration_skips_boxes_by_their_distance_ahead():
    file = shared("oracles/carlasimu_yaml/boundingBox.yaml")
    config = load_config(file.read_bytes()).config
    solids = [
        {"transform": {"x": x, "y": y, "z": 0}, "extent": [2, 1, 1]} for x, y in PLACES
    ]
    boxes = [{"class": "car", "box3d": solid} for solid in solids]
    camera: dict[str, object] = {"width": 320, "height": 180, "fov": 90}
    camera["transform"] = {"x": 0, "y": 0, "z": 1}
    cars = png(np.full((180, 320, 3), (0, 0, 142), np.uint8))

    result = filter_frame({"camera": camera, "boxes": boxes}, cars, config)

    reasons = [box["reason"] for box in result.decisions]
    assert dict(zip(PLACES, reasons, strict=True)) == PLACES
    assert result.decisions[-1]["explanation"] == (
        "rejected: its centre is not far enough ahead of the camera"
    )
