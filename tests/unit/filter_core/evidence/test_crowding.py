"""Crowding: the largest share of a box that one other box of a like class covers."""

import numpy as np
import pytest

from filter_core.evidence.crowding import crowding_percent

CAR, TRUCK_OR_CAR, WALKER = 1 << 14, 1 << 14 | 1 << 15, 1 << 12
TEN = (0.0, 0.0, 10.0, 10.0)
NAN_RECTANGLE = (float("nan"),) * 4


@pytest.mark.parametrize(
    ("boxes", "masks", "expected"),
    [
        pytest.param([TEN], [CAR], [0], id="alone"),
        pytest.param([TEN, TEN], [CAR, CAR], [100, 100], id="twice the same box"),
        pytest.param([TEN, TEN], [CAR, WALKER], [0, 0], id="of another class"),
        pytest.param([TEN, TEN], [CAR, TRUCK_OR_CAR], [100, 100], id="of a like class"),
        pytest.param([TEN, TEN], [0, 0], [0, 0], id="of no class"),
        pytest.param([(0, 0, 1e-200, 1e-200)] * 2, [CAR, CAR], [0, 0], id="no area"),
        pytest.param([(0, 0, 0.1, 0.9)] * 2, [CAR, CAR], [100, 100], id="rounded up"),
        pytest.param([(0, 0, 0.1, 1.7)] * 2, [CAR, CAR], [100, 100], id="rounded down"),
        pytest.param([TEN, NAN_RECTANGLE], [CAR, CAR], [0, 0], id="not on the image"),
        pytest.param(
            [TEN, (5, 0, 25, 10)], [CAR, CAR], [50, 25], id="each by its own area"
        ),
        pytest.param([TEN, (10, 0, 20, 10)], [CAR, CAR], [0, 0], id="side by side"),
        pytest.param(
            [TEN, (0, 0, 10, 4), (0, 4, 10, 10)],
            [CAR, CAR, CAR],
            [60, 100, 100],
            id="the largest counts, not the sum",
        ),
    ],
)
def test_crowding_is_the_largest_share_covered_by_one_other_box(boxes, masks, expected):
    percent = crowding_percent(np.array(boxes), np.array(masks))

    assert percent.tolist() == expected


def test_crowding_without_boxes_is_empty():
    assert crowding_percent(np.empty((0, 4)), np.empty(0, np.int64)).shape == (0,)
