"""KITTI's 3D boxes: bottom centre, sizes and heading in the camera's axes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from filter_core.geometry.box3d import in_carla_order
from filter_core.geometry.camera import CARLA_TO_IMAGE_AXES, Camera
from filter_core.types import FloatArray

_BOTTOM: Final = [0, 2, 4, 6]
"""Corners at -z, in CARLA's order."""


@dataclass(frozen=True)
class KittiBox:
    """A 3D box as KITTI gives it: x right, y down, z forward.

    Attributes
    ----------
    dimensions : height, width and length, metres
    location : of the middle of the bottom face, metres
    rotation_y : radians, about the axis that points down
    alpha : radians
        The heading as the camera sees it: without the direction to the box.
    """

    dimensions: tuple[float, float, float]
    location: tuple[float, float, float]
    rotation_y: float
    alpha: float


def to_kitti_box(vertices: FloatArray, camera: Camera) -> KittiBox:
    """A box from its world corners.

    Parameters
    ----------
    vertices : (8, 3), metres
        In any order; `in_carla_order` has the last word on which axis is the length.
    camera : Camera

    Notes
    -----
    KITTI turns boxes about one axis only. A camera that looks down or rolls sees boxes
    that are turned about the others as well; of those the heading is kept.
    """
    corners = in_carla_order(vertices)[0]
    motion = camera.world_to_camera
    moved = corners @ motion[:3, :3].T + motion[:3, 3]
    seen = moved @ CARLA_TO_IMAGE_AXES.T
    length, width, height = (
        float(np.linalg.norm(seen[bit] - seen[0])) for bit in (4, 2, 1)
    )
    x, y, z = (float(v) for v in seen[_BOTTOM].mean(axis=0))
    forward = seen[4] - seen[0]
    rotation_y = math.atan2(-float(forward[2]), float(forward[0]))
    return KittiBox(
        dimensions=(height, width, length),
        location=(x, y, z),
        rotation_y=rotation_y,
        alpha=_half_turn(rotation_y - math.atan2(x, z)),
    )


def kitti_vertices(
    dimensions: tuple[float, float, float],
    location: tuple[float, float, float],
    rotation_y: float,
) -> FloatArray:
    """(8, 3) corners in CARLA's axes of the camera (forward, right, up) and order."""
    height, width, length = dimensions
    cos, sin = math.cos(rotation_y), math.sin(rotation_y)
    forward = np.array([cos, 0.0, -sin]) * length
    right = np.array([-sin, 0.0, -cos]) * width
    up = np.array([0.0, -height, 0.0])
    corners = [
        np.array(location) + (x - 0.5) * forward + (y - 0.5) * right + z * up
        for x in (0, 1)
        for y in (0, 1)
        for z in (0, 1)
    ]
    vertices: FloatArray = np.array(corners) @ CARLA_TO_IMAGE_AXES
    return vertices


def _half_turn(angle: float) -> float:
    """The same angle from -pi to pi."""
    return math.remainder(angle, 2 * math.pi)
