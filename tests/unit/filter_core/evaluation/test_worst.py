"""An evaluation lists the largest disagreements with the truth, largest first."""

import numpy as np

from filter_core.evaluation.comparison import MOST, LargestErrors
from tests.support.evidence import evidence_of

LOST, GHOST = (False, True), (True, False)


def add(worst, boxes, outcomes):
    kept, visible = np.array(outcomes, np.bool_).T
    worst.add(evidence_of(boxes), kept, visible, lambda row: {"row": row})


def test_ghost_counts_its_box_pixels_and_lost_object_its_matched_pixels():
    worst = LargestErrors()
    boxes = [
        {"box_pixels": 500, "matched_pixels": 20},
        {"box_pixels": 400, "matched_pixels": 70},
        {"box_pixels": 900, "matched_pixels": 90},
    ]

    add(worst, boxes, [GHOST, LOST, (True, True)])

    listed = [(box.name["row"], box.error, box.pixels) for box in worst.boxes]
    assert listed == [(0, "kept_hidden", 500), (1, "rejected_visible", 70)]


def test_only_the_largest_errors_are_kept():
    worst = LargestErrors()
    sizes = list(range(100, 100 + 3 * MOST))
    for start in (0, MOST, 2 * MOST):
        part = [{"box_pixels": size} for size in sizes[start : start + MOST]]
        add(worst, part, [GHOST] * MOST)

    assert [box.pixels for box in worst.boxes] == sizes[::-1][:MOST]
