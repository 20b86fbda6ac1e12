"""Points of a semantic LiDAR inside 3D boxes."""

from __future__ import annotations

from typing import Final

import numpy as np

from filter_core.box3d import in_carla_order
from filter_core.channel_types import NOT_MEASURED
from filter_core.channels.points import LidarPoints
from filter_core.pose import Transform
from filter_core.types import UNKNOWN_COLUMN, BoolArray, FloatArray, IntArray

_FLATTEST: Final = 1e-9


def points_inside(
    points: LidarPoints,
    sensor: Transform,
    vertices: FloatArray,
    accept_mask: IntArray,
) -> IntArray:
    """How many points of an accepted tag lie inside each box.

    Parameters
    ----------
    points : LidarPoints
    sensor : Transform
        The LiDAR's own, in the world: it rarely stands where the camera does.
    vertices : (N, 8, 3) float64, metres; NaN rows for boxes that are not 3D
    accept_mask : (N,) int64

    Returns
    -------
    (N,) int64
        `NOT_MEASURED` for boxes that are not 3D.

    Notes
    -----
    Exact for every parallelepiped. Points are sorted along x first, so that each box
    looks at a slice of them only.
    """
    counts = np.full(len(vertices), NOT_MEASURED, np.int64)
    matrix = sensor.matrix
    order, world = _sorted_by_x(points.xyz @ matrix[:3, :3].T + matrix[:3, 3])
    tags = np.clip(points.tag, 0, UNKNOWN_COLUMN)[order]
    solid = np.flatnonzero(~np.isnan(vertices).any(axis=(1, 2)))
    corners = in_carla_order(vertices[solid])
    for row, box in zip(solid.tolist(), corners, strict=True):
        begin, end = np.searchsorted(world[:, 0], [box[:, 0].min(), box[:, 0].max()])
        near = slice(int(begin), int(end) + 1)
        wanted = int(accept_mask[row]) & (1 << UNKNOWN_COLUMN) - 1
        accepted = (wanted >> tags[near] & 1).astype(np.bool_)
        counts[row] = np.count_nonzero(_inside(world[near][accepted], box))
    return counts


def _sorted_by_x(world: FloatArray) -> tuple[IntArray, FloatArray]:
    order = np.argsort(world[:, 0], kind="stable")
    return order, world[order]


def _inside(points: FloatArray, box: FloatArray) -> BoolArray:
    """(P,) bool: in the coordinates of the box's own axes, 0..1 along each."""
    axes = np.stack([box[4] - box[0], box[2] - box[0], box[1] - box[0]], axis=1)
    if abs(np.linalg.det(axes)) < _FLATTEST:
        return np.zeros(len(points), np.bool_)
    local = np.linalg.solve(axes, (points - box[0]).T)
    return np.asarray(((local >= 0) & (local <= 1)).all(axis=0))
