"""From triangles in the world to triangles on the screen."""

from __future__ import annotations

from typing import Final

import numpy as np

from app.demo.mesh import cross, turned
from filter_core.geometry.camera import Camera
from filter_core.types import BoolArray, FloatArray, IntArray

NEAR: Final = 0.1
"""Metres; nothing nearer is drawn, as in Unreal Engine."""


def to_screen(
    corners: FloatArray, normals: FloatArray, camera: Camera, two_sided: BoolArray
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
    homogeneous = to_homogeneous(corners, camera)
    kept = np.flatnonzero(_in_view(homogeneous, camera))
    facing = _faces_camera(corners[kept], normals[kept], camera.position)
    kept = kept[facing | two_sided[kept]]
    points, source = _clip_near(homogeneous[kept])
    depth = points[..., 2]
    screen = np.stack(
        [points[..., 0] / depth, points[..., 1] / depth, 1.0 / depth], axis=-1
    )
    return screen, kept[source]


def to_homogeneous(points: FloatArray, camera: Camera) -> FloatArray:
    """World points (..., 3) to (u depth, v depth, depth)."""
    image = camera.world_to_image
    return turned(points, image[:, :3]) + image[:, 3]


def _in_view(points: FloatArray, camera: Camera) -> BoolArray:
    """Triangles that are not wholly on the wrong side of one of the five planes."""
    u, v, depth = points[..., 0], points[..., 1], points[..., 2]
    inside = (
        depth > NEAR,
        u > 0,
        v > 0,
        u < camera.width * depth,
        v < camera.height * depth,
    )
    seen = np.ones(len(points), dtype=bool)
    for side in inside:
        # Column by column: reducing an axis of three is many times slower.
        seen &= side[:, 0] | side[:, 1] | side[:, 2]
    return seen


def _faces_camera(
    corners: FloatArray, normals: FloatArray, eye: FloatArray
) -> BoolArray:
    first = corners[:, 0]
    plane = cross(corners[:, 1] - first, corners[:, 2] - first)
    outwards = _products(plane, normals[:, 0] + normals[:, 1] + normals[:, 2])
    towards = _products(plane, eye - first)
    return np.asarray(outwards * towards > 0)


def _products(one: FloatArray, two: FloatArray) -> FloatArray:
    """(N,) scalar products of pairs of vectors."""
    return np.asarray(
        one[:, 0] * two[:, 0] + one[:, 1] * two[:, 1] + one[:, 2] * two[:, 2]
    )


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
