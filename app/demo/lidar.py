"""A semantic LiDAR at the camera's place, read from the frame's planes."""

from __future__ import annotations

import io
from typing import Final

import numpy as np
from numpy.typing import NDArray

from app.demo.exposure import Planes
from app.demo.mesh import turned
from filter_core.geometry.camera import Camera
from filter_core.types import IntArray

RANGE_M: Final = 120.0
_CHANNELS: Final = 40
_TURNS: Final = 640
_LOWEST, _HIGHEST = -24.0, 8.0
"""Degrees below and above the horizon, as seen by the sensor."""

POINT: Final = np.dtype(
    [
        ("x", "<f4"), ("y", "<f4"), ("z", "<f4"),
        ("CosAngle", "<f4"), ("ObjIdx", "<u4"), ("ObjTag", "<u4"),
    ]
)  # fmt: skip
"""One point, as `carla.SemanticLidarMeasurement` delivers it."""


def scan(planes: Planes, camera: Camera, ids: IntArray) -> NDArray[np.void]:
    """(P,) points of `POINT` in the sensor's axes: x forward, y right, z up.

    Parameters
    ----------
    planes : Planes
    camera : Camera
    ids : (things + 1,)
        The actor of each thing; the last one is that of sky and ground.
    """
    focal = float(camera.intrinsic[0, 0])
    row, column = _targets(camera, focal)
    depth = planes.depth[row, column].astype(np.float64)
    right = (column + 0.5 - camera.width / 2) / focal
    up = (camera.height / 2 - row - 0.5) / focal
    place = np.stack([np.ones_like(right), right, up], axis=1) * depth[:, None]
    length = np.linalg.norm(place, axis=1)
    hit = np.flatnonzero(length <= RANGE_M)
    points = np.zeros(len(hit), dtype=POINT)
    for axis, name in enumerate("xyz"):
        points[name] = place[hit, axis]
    towards = place[hit] / length[hit, None]
    normals = planes.normals[row[hit], column[hit]].astype(np.float64)
    local = turned(normals, camera.world_to_camera[:3, :3])
    points["CosAngle"] = np.abs(np.sum(towards * local, axis=1))
    points["ObjIdx"] = ids[planes.owner[row[hit], column[hit]]]
    points["ObjTag"] = planes.tags[row[hit], column[hit]]
    return points


def npy(points: NDArray[np.void]) -> bytes:
    """The points as a .npy file."""
    buffer = io.BytesIO()
    np.save(buffer, points)
    return buffer.getvalue()


def _targets(camera: Camera, focal: float) -> tuple[IntArray, IntArray]:
    """The pixels that the beams within the image fall on."""
    half = np.degrees(np.arctan(camera.width / 2 / focal))
    turn = np.radians(np.linspace(-half, half, _TURNS))
    tilt = np.radians(np.linspace(_LOWEST, _HIGHEST, _CHANNELS))
    right = np.broadcast_to(np.tan(turn), (_CHANNELS, _TURNS))
    up = np.tan(tilt)[:, None] / np.cos(turn)
    column = np.floor(right * focal + camera.width / 2).astype(np.int64)
    row = np.floor(camera.height / 2 - up * focal).astype(np.int64)
    inside = (
        (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
    )
    return row[inside], column[inside]
