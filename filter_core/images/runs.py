"""Runs of equal values: a segmentation has a fiftieth as many runs as pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from filter_core.types import BoolArray, IntArray


def run_ends(flat: NDArray[Any], stops: IntArray | None = None) -> IntArray:
    """The index of the last element of each run of equal elements.

    Parameters
    ----------
    flat : (N,) of integers
    stops : ascending indexes, optional
        A run also ends before each of these; 0 is none.

    Returns
    -------
    (R,) int64, ascending; its last is N - 1
    """
    size = len(flat)
    if not size:
        return np.empty(0, dtype=np.int64)
    # A multiple of eight, as `positions` likes it.
    last = np.zeros(-(-size // 8) * 8, dtype=np.bool_)
    np.not_equal(flat[1:], flat[:-1], out=last[: size - 1])
    last[size - 1] = True
    if stops is not None:
        last[stops[stops > 0] - 1] = True
    return positions(last)


def run_lengths(ends: IntArray) -> IntArray:
    """How many elements each run has."""
    lengths = np.empty_like(ends)
    lengths[:1] = ends[:1] + 1
    np.subtract(ends[1:], ends[:-1], out=lengths[1:])
    return lengths


def positions(mask: BoolArray) -> IntArray:
    """``flatnonzero`` of a sparse mask, in half the time: eight elements at once."""
    flat = mask.reshape(-1)
    if len(flat) % 8:
        flat = np.append(flat, np.zeros(8 - len(flat) % 8, dtype=np.bool_))
    words = flat.view(np.uint64)
    hit = np.flatnonzero(words != 0)
    inside = np.flatnonzero(words[hit].view(np.bool_))
    found: IntArray = (hit[inside >> 3] << 3) + (inside & 7)
    return found
