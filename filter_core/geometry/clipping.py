"""Exact clipping of segments and convex shapes. No cameras and no boxes here."""

from __future__ import annotations

from itertools import combinations
from typing import Final

import numpy as np

from filter_core.types import BoolArray, FloatArray, IntArray

MAX_CORNERS: Final = 20
"""A plane cuts 8 points into k and 8 - k: at most ``k + k (8 - k)`` corners, k = 4."""


def all_pairs(count: int) -> IntArray:
    """(count (count - 1) / 2, 2): every segment between `count` points."""
    return np.array(list(combinations(range(count), 2)), dtype=np.int64)


_PAIRS: Final = {count: all_pairs(count) for count in (8, MAX_CORNERS)}


def clip_segments(
    start: FloatArray, end: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The part of segments that lies inside half-spaces.

    Parameters
    ----------
    start, end : (..., H)
        Signed distances of both ends from H planes, 0 and more inside. They must be
        linear along the segment; any positive scale per plane will do.

    Returns
    -------
    enter, leave : (...), 0..1
        The part inside runs from ``start + enter (end - start)`` to ``leave``.
    inside : (...), bool
        False where nothing is inside.

    References
    ----------
    .. [1] Y.-D. Liang, B. Barsky, "A New Concept and Method for Line Clipping",
       ACM Transactions on Graphics 3(1), 1984.
    """
    # Where both ends are on one side, a tiny step would overflow the division.
    crosses = (start < 0) != (end < 0)
    crossing = start / np.where(crosses, start - end, 1.0)
    enter = np.where(start < 0, crossing, 0.0).max(axis=-1)
    leave = np.where(end < 0, crossing, 1.0).min(axis=-1)
    wholly_out = ((start < 0) & (end < 0)).any(axis=-1)
    return enter, leave, ~wholly_out & (enter <= leave)


def cut_hull(points: FloatArray, distance: FloatArray) -> FloatArray:
    """Corners of the hull of 8 points after a cut by one plane.

    Parameters
    ----------
    points : (N, 8, D)
    distance : (N, 8)
        From the plane, 0 and more is kept; at least one point of each row must be.

    Returns
    -------
    (N, `MAX_CORNERS`, D)
        Points whose hull is the kept part; padded by repeating a kept point.

    Notes
    -----
    Every edge of the hull is among the 28 segments between its points, and every such
    segment lies within the hull: the order of the points does not matter.
    """
    first, second = _PAIRS[8].T
    d_first, d_second = distance[:, first], distance[:, second]
    crosses = (d_first >= 0) != (d_second >= 0)
    share = d_first / np.where(crosses, d_first - d_second, 1.0)
    crossing = points[:, first] + share[..., None] * (
        points[:, second] - points[:, first]
    )
    candidates = np.concatenate([points, crossing], axis=1)
    kept = np.concatenate([distance >= 0, crosses], axis=1)
    order = np.argsort(~kept, axis=1, kind="stable")[:, :MAX_CORNERS]
    order = np.where(np.take_along_axis(kept, order, axis=1), order, order[:, :1])
    return np.take_along_axis(candidates, order[..., None], axis=1)


def bounds_of(points: FloatArray) -> FloatArray:
    """(N, 4) ``xyxy``: the smallest rectangles around (N, P, 2) points."""
    return np.concatenate([points.min(axis=1), points.max(axis=1)], axis=1)


def hull_bounds_in_image(points: FloatArray, wh: tuple[int, int]) -> FloatArray:
    """The smallest rectangles around what the image shows of convex shapes.

    Parameters
    ----------
    points : (N, P, 2), px
        Points whose hulls are the shapes; P is 8 or `MAX_CORNERS`.
    wh : (width, height), px

    Returns
    -------
    (N, 4) float64 ``xyxy``, px
        NaN rows where the image shows nothing.

    Notes
    -----
    What remains of a convex shape between the image's top and bottom has an interval
    of x, and over each x of it some point within; so clamping that interval to the
    image's width is exact. Likewise for y. No hull has to be built.
    """
    x_low, x_high = _range_in_strip(points, axis=0, limit=wh[1])
    y_low, y_high = _range_in_strip(points, axis=1, limit=wh[0])
    low = np.maximum(np.stack([x_low, y_low], axis=1), 0.0)
    high = np.minimum(np.stack([x_high, y_high], axis=1), wh)
    bounds = np.concatenate([low, high], axis=1)
    bounds[(low > high).any(axis=1)] = np.nan
    return bounds


def _range_in_strip(
    points: FloatArray, *, axis: int, limit: int
) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest `axis` where the other axis is within 0..limit."""
    first, second = _PAIRS[points.shape[1]].T
    along, across = points[..., axis], points[..., 1 - axis]
    distance = np.stack([across, limit - across], axis=-1)
    enter, leave, inside = clip_segments(distance[:, first], distance[:, second])
    start, step = along[:, first], along[:, second] - along[:, first]
    ends = np.stack([start + enter * step, start + leave * step])
    # Rounding must not move an end beyond the corners themselves.
    np.clip(ends, along.min(axis=1)[:, None], along.max(axis=1)[:, None], out=ends)
    low = np.where(inside, ends, np.inf).min(axis=(0, 2))
    high = np.where(inside, ends, -np.inf).max(axis=(0, 2))
    return low, high
