"""From triangles in the world to triangles on the screen."""

from __future__ import annotations

from typing import Final

import numpy as np

from filter_core.camera import Camera
from filter_core.types import FloatArray, IntArray

NEAR: Final = 0.1
"""Metres; nothing nearer is drawn, as in Unreal Engine."""


def to_screen(
    corners: FloatArray, normals: FloatArray, camera: Camera, two_sided: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Project triangles, without those that cannot be seen.

    Parameters
    ----------
    corners, normals : (T, 3, 3) world
    camera : Camera
    two_sided : (T,) bool
        Triangles that are also seen from behind.

    Returns
    -------
    (N, 3, 3) float64
        Per corner u px, v px, 1 / depth.
    (N,) int64
        The triangle that each comes from; one cut by the near plane may come twice.
    """
    image = camera.world_to_image
    homogeneous = corners @ image[:, :3].T + image[:, 3]
    kept = np.flatnonzero(_in_view(homogeneous, camera))
    facing = _faces_camera(corners[kept], normals[kept], camera.position)
    kept = kept[facing | two_sided[kept].astype(bool)]
    points, source = _clip_near(homogeneous[kept])
    depth = points[..., 2]
    screen = np.stack(
        [points[..., 0] / depth, points[..., 1] / depth, 1.0 / depth], axis=-1
    )
    return screen, kept[source]


def _in_view(points: FloatArray, camera: Camera) -> FloatArray:
    """Triangles that are not wholly on the wrong side of one of the five planes."""
    u, v, depth = points[..., 0], points[..., 1], points[..., 2]
    seen: FloatArray = (
        (depth > NEAR).any(axis=1)
        & (u > 0).any(axis=1)
        & (v > 0).any(axis=1)
        & (u < camera.width * depth).any(axis=1)
        & (v < camera.height * depth).any(axis=1)
    )
    return seen


def _faces_camera(
    corners: FloatArray, normals: FloatArray, eye: FloatArray
) -> FloatArray:
    first = corners[:, 0]
    plane = np.cross(corners[:, 1] - first, corners[:, 2] - first)
    outwards = np.sum(plane * normals.sum(axis=1), axis=1)
    towards = np.sum(plane * (eye - first), axis=1)
    facing: FloatArray = outwards * towards > 0
    return facing


def _clip_near(points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Cut at the near plane: one corner in front leaves one triangle, two leave two."""
    front = points[..., 2] > NEAR
    count = front.sum(axis=1)
    whole = np.flatnonzero(count == 3)
    parts, sources = [points[whole]], [whole]
    for inside in (1, 2):
        cut = np.flatnonzero(count == inside)
        # Turn the odd corner to the front: the only one in, or the only one out.
        odd = np.argmax(front[cut] == (inside == 1), axis=1)
        turned = (odd[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(
            np.take_along_axis(points[cut], turned[:, :, None], axis=1), 1, 0
        )
        ab, ac = _at_near(a, b), _at_near(a, c)
        triangles = [(a, ab, ac)] if inside == 1 else [(ab, b, c), (ab, c, ac)]
        for triangle in triangles:
            parts.append(np.stack(triangle, axis=1))
            sources.append(cut)
    return np.concatenate(parts), np.concatenate(sources)


def _at_near(a: FloatArray, b: FloatArray) -> FloatArray:
    """Where the lines from a to b cross the near plane."""
    share = (NEAR - a[:, 2]) / (b[:, 2] - a[:, 2])
    crossing = a + share[:, None] * (b - a)
    crossing[:, 2] = NEAR
    return crossing
