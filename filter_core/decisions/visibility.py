"""How much of an object is hidden and cut off, in the words of label formats."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

FULLY_VISIBLE: Final = 0

PARTLY_OCCLUDED: Final = 1

LARGELY_OCCLUDED: Final = 2

UNKNOWN_OCCLUSION: Final = 3

_PARTLY_FROM: Final = 10.0

_LARGELY_FROM: Final = 50.0
"""Percent of the silhouette; KITTI's annotators judged by eye."""


def occlusion_level(nearer_percent: float | None) -> int:
    """KITTI's level of occlusion.

    Parameters
    ----------
    nearer_percent : float or None, percent of the silhouette
        What something nearer covers; None or NaN: unknown.

    Returns
    -------
    int
        0 fully visible, 1 partly, 2 largely occluded, 3 unknown.

    References
    ----------
    .. [1] A. Geiger, P. Lenz, R. Urtasun, "Are we ready for autonomous driving? The
       KITTI vision benchmark suite", CVPR 2012; readme of the object development kit.
    """
    if nearer_percent is None or math.isnan(nearer_percent):
        return UNKNOWN_OCCLUSION
    if nearer_percent >= _LARGELY_FROM:
        return LARGELY_OCCLUDED
    return PARTLY_OCCLUDED if nearer_percent >= _PARTLY_FROM else FULLY_VISIBLE


def truncation(
    amodal_xyxy: Sequence[float] | None, visible_xyxy: Sequence[float] | None
) -> float | None:
    """Which share of a box lies outside the image, 0..1; None where it is unknown."""
    if amodal_xyxy is None or math.isnan(amodal_xyxy[0]):
        return None
    whole = _area(amodal_xyxy)
    if visible_xyxy is None or math.isnan(visible_xyxy[0]) or whole <= 0:
        return 1.0
    return min(max(1.0 - _area(visible_xyxy) / whole, 0.0), 1.0)


def _area(xyxy: Sequence[float]) -> float:
    return (xyxy[2] - xyxy[0]) * (xyxy[3] - xyxy[1])
