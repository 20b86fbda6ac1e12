"""Which way a surface faces at each sample, smooth over curved skins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.demo.mesh import cross
from app.demo.snapshot import Snapshot, homogeneous_corners
from app.demo.textures import Float32, f32
from filter_core.types import BoolArray, IntArray


def sample_normals(
    snapshot: Snapshot, triangle: NDArray[np.int32], uv: Float32
) -> Float32:
    """(N, 3) float32: normals of the triangles at places (N, 2) on the screen."""
    normals = snapshot.mesh.normals
    flat = f32(normals[triangle, 0])
    bent = _bent(snapshot, triangle)
    chosen = np.flatnonzero(bent[triangle])
    flat[chosen] = _smooth(snapshot, triangle[chosen], uv[chosen], flat[chosen])
    return flat


def _bent(snapshot: Snapshot, triangle: NDArray[np.int32]) -> BoolArray:
    """(T,): triangles in use whose corners have different normals."""
    normals = snapshot.mesh.normals
    used = np.zeros(len(normals), dtype=bool)
    used[triangle] = True
    numbers = np.flatnonzero(used)
    corner = normals[numbers]
    spread = np.abs(corner[:, 1:] - corner[:, :1]).reshape(-1, 6).sum(axis=1)
    bent = np.zeros(len(normals), dtype=bool)
    bent[numbers] = spread > 1e-6
    return bent


def _smooth(
    snapshot: Snapshot, triangle: NDArray[np.int32], uv: Float32, flat: Float32
) -> Float32:
    """A normal divided by the depth is linear on the screen.

    So three coefficients per axis and triangle say it for every sample.
    """
    unique, which = _numbered(triangle, len(snapshot.mesh))
    rows = homogeneous_corners(snapshot, unique)
    a, b, c = rows[:, 0], rows[:, 1], rows[:, 2]
    inverse = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=2)
    volume = np.einsum("ni,ni->n", a, cross(b, c))
    sound = np.abs(volume) > 1e-9
    inverse /= np.where(sound, volume, 1.0)[:, None, None]
    slope = np.einsum("nij,njk->nik", inverse, snapshot.mesh.normals[unique])
    per_sample = slope.astype(np.float32).reshape(-1, 9)[which]
    normals = per_sample[:, :3] * uv[:, :1]
    normals += per_sample[:, 3:6] * uv[:, 1:]
    normals += per_sample[:, 6:]
    length = np.sqrt(np.einsum("ij,ij->i", normals, normals))[:, None]
    good = sound[which] & (length[:, 0] > 1e-12)
    return np.where(good[:, None], normals / np.maximum(length, 1e-12), flat)


def _numbered(
    triangle: NDArray[np.int32], count: int
) -> tuple[IntArray, NDArray[np.int64]]:
    """The triangles that occur, and for each sample its place among them."""
    used = np.zeros(count, dtype=bool)
    used[triangle] = True
    unique = np.flatnonzero(used)
    place = np.zeros(count, dtype=np.int64)
    place[unique] = np.arange(len(unique))
    return unique, place[triangle]
