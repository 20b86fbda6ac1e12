"""Crowding: the largest share of a box that one other box of a like class covers."""

import numpy as np
import pytest

from filter_core.evidence.crowding import crowding_percent

CAR, TRUCK_OR_CAR, WALKER = 1 << 14, 1 << 14 | 1 << 15, 1 << 12
TEN = (0.0, 0.0, 10.0, 10.0)
NAN_RECTANGLE = (float("nan"),) * 4


CROWDS = {
    "alone": ([TEN], [CAR], [0]),
    "twice the same box": ([TEN, TEN], [CAR, CAR], [100, 100]),
    "of another class": ([TEN, TEN], [CAR, WALKER], [0, 0]),
    "of a like class": ([TEN, TEN], [CAR, TRUCK_OR_CAR], [100, 100]),
    "of no class": ([TEN, TEN], [0, 0], [0, 0]),
    "no area": ([(0, 0, 1e-200, 1e-200)] * 2, [CAR, CAR], [0, 0]),
    "rounded up": ([(0, 0, 0.1, 0.9)] * 2, [CAR, CAR], [100, 100]),
    "rounded down": ([(0, 0, 0.1, 1.7)] * 2, [CAR, CAR], [100, 100]),
    "not on the image": ([TEN, NAN_RECTANGLE], [CAR, CAR], [0, 0]),
    "each by its own area": ([TEN, (5, 0, 25, 10)], [CAR, CAR], [50, 25]),
    "side by side": ([TEN, (10, 0, 20, 10)], [CAR, CAR], [0, 0]),
    "the largest counts, not the sum": (
        [TEN, (0, 0, 10, 4), (0, 4, 10, 10)],
        [CAR, CAR, CAR],
        [60, 100, 100],
    ),
}


@pytest.mark.parametrize(("boxes", "masks", "expected"), CROWDS.values(), ids=CROWDS)
def test_crowding_is_the_largest_share_covered_by_one_other_box(boxes, masks, expected):
    percent = crowding_percent(np.array(boxes), np.array(masks))

    assert percent.tolist() == expected


def test_crowding_without_boxes_is_empty():
    assert crowding_percent(np.empty((0, 4)), np.empty(0, np.int64)).shape == (0,)
