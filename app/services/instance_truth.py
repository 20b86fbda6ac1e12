"""Which boxes' truth is known from instance images, and what it is."""

from __future__ import annotations

import numpy as np

from app.services.numbers import DatasetNumbers
from filter_core.types import NOT_MEASURED, BoolArray, IntArray


def instance_truth(numbers: DatasetNumbers) -> tuple[IntArray, BoolArray]:
    """Boxes of frames with an instance image: visible is what has one pixel."""
    channels = numbers.evidence.channels
    if channels is None:
        return np.empty(0, np.int64), np.empty(0, np.bool_)
    rows = np.flatnonzero(channels.instance_pixels != NOT_MEASURED)
    return rows, channels.instance_pixels[rows] > 0
