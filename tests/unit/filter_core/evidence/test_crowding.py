"""Crowding: the largest share of a box that one other box of a like class covers."""

import numpy as np
import pytest

from filter_core.evidence.crowding import crowding_percent

CAR = 1 << 14
TEN = (0.0, 0.0, 10.0, 10.0)


CROWDS = {
    "no box": (np.empty((0, 4)), np.empty(0, np.int64), []),
    "no area": ([(0, 0, 1e-200, 1e-200)] * 2, [CAR, CAR], [0, 0]),
    "rounded up": ([(0, 0, 0.1, 0.9)] * 2, [CAR, CAR], [100, 100]),
    "rounded down": ([(0, 0, 0.1, 1.7)] * 2, [CAR, CAR], [100, 100]),
    "each by its own area": ([TEN, (5, 0, 25, 10)], [CAR, CAR], [50, 25]),
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
