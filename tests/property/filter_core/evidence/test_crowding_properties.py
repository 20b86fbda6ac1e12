"""The fast search for the most crowding neighbour equals comparing all pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filter_core.evidence.crowding import crowding_percent
from tests.support.slow_definitions import slow_crowding

MASKS = np.array([0, 1 << 14, 3 << 14, 1 << 16, 5 << 12, 1 << 12])
SHAPES = ("any", "tiny", "alike", "thin", "stacked", "grid")


def random_boxes(shape: str, count: int, seed: int) -> np.ndarray:
    """Random boxes of a kind that makes the search hard; a few are NaN."""
    rng = np.random.default_rng(seed)
    size = {
        "any": np.exp(rng.uniform(0, 6.5, (count, 2))),
        "tiny": rng.uniform(1e-6, 3, (count, 2)),
        "alike": np.full((count, 2), (60.0, 50.0)),
        "thin": np.where(rng.random((count, 1)) < 0.5, (1.0, 200.0), (200.0, 1.0)),
        "stacked": rng.uniform(50, 60, (count, 2)),
        "grid": rng.integers(1, 4, (count, 2)) * 8.0,
    }[shape]
    corner = rng.uniform((0, 0), (1280, 720), (count, 2))
    if shape == "stacked":
        corner = rng.uniform(0, 5, (count, 2))
    if shape == "grid":
        corner = np.floor(corner / 8) * 8
    boxes = np.hstack([corner, corner + size])
    boxes[rng.random(count) < 0.02] = np.nan
    return boxes


@pytest.mark.parametrize("shape", SHAPES)
@given(count=st.integers(0, 60), seed=st.integers(0, 2**32 - 1))
def test_crowding_of_few_boxes_equals_the_slow_definition(shape, count, seed):
    boxes = random_boxes(shape, count, seed)
    masks = np.random.default_rng(seed).choice(MASKS, count)

    percent = crowding_percent(boxes, masks)

    assert percent.tolist() == slow_crowding(boxes, masks)


@pytest.mark.parametrize("shape", SHAPES)
@given(seed=st.integers(0, 2**32 - 1))
def test_crowding_search_equals_comparing_all_pairs(shape, seed):
    boxes = random_boxes(shape, 300, seed)
    masks = np.random.default_rng(seed).choice(MASKS, len(boxes))

    searched = crowding_percent(boxes, masks, most_pairs=0)
    compared = crowding_percent(boxes, masks, most_pairs=len(boxes) ** 2)

    np.testing.assert_array_equal(searched, compared)
