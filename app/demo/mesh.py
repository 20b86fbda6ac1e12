"""Triangles in space: corners, normals, paint and tag. Knows no camera."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.demo.paint import DYE_COLUMN, SURFACE_COLUMNS, Paint
from filter_core.types import FloatArray

Real = TypeVar("Real", np.float32, np.float64)


@dataclass(frozen=True, eq=False)
class Mesh:
    """A heap of triangles.

    Attributes
    ----------
    corners, normals : (T, 3, 3) float64
        Triangle, corner, axis. The normals point outwards; their order says nothing.
    surface : (T, SURFACE_COLUMNS) float32
    tag : (T,) uint8
    """

    corners: FloatArray
    normals: FloatArray
    surface: NDArray[np.float32]
    tag: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.corners)

    @classmethod
    def of(
        cls, corners: FloatArray, normals: FloatArray, paint: Paint, tag: int
    ) -> Mesh:
        """Triangles of one paint and one tag."""
        count = len(corners)
        surface = np.tile(paint.row(), (count, 1))
        return cls(corners, normals, surface, np.full(count, tag, dtype=np.uint8))

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """The lowest and the highest corner, per axis."""
        points = self.corners.reshape(-1, 3)
        return points.min(axis=0), points.max(axis=0)

    def placed(self, matrix: FloatArray) -> Mesh:
        """The mesh after a rigid motion (4, 4)."""
        turn = matrix[:3, :3]
        return Mesh(
            turned(self.corners, turn) + matrix[:3, 3],
            turned(self.normals, turn),
            self.surface,
            self.tag,
        )

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Mesh:
        """The mesh somewhere else."""
        shifted = self.corners + np.array([x, y, z])
        return Mesh(shifted, self.normals, self.surface, self.tag)

    def repeated(self, places: FloatArray) -> Mesh:
        """A copy at each of (N, 3) places."""
        count = len(places)
        copies = self.corners[None] + places[:, None, None, :]
        return Mesh(
            copies.reshape(-1, 3, 3),
            np.tile(self.normals, (count, 1, 1)),
            np.tile(self.surface, (count, 1)),
            np.tile(self.tag, count),
        )

    def dyed(self, colors: Mapping[int, tuple[float, float, float]]) -> Mesh:
        """The mesh with other colours where its paint is a dye (see `Paint.dye`)."""
        surface = self.surface.copy()
        for number, rgb in colors.items():
            surface[self.surface[:, DYE_COLUMN] == number, :3] = Paint(rgb).row()[:3]
        return Mesh(self.corners, self.normals, surface, self.tag)

    def mirrored(self) -> Mesh:
        """The mesh on the other side of the plane y = 0."""
        flip = np.array([1.0, -1.0, 1.0])
        return Mesh(self.corners * flip, self.normals * flip, self.surface, self.tag)

    def both_sides(self) -> Mesh:
        """The mesh and its mirror image."""
        return join([self, self.mirrored()])


def cross(one: FloatArray, two: FloatArray) -> FloatArray:
    """Vector products along the last axis; numpy's own takes four times as long."""
    a, b, c = one[..., 0], one[..., 1], one[..., 2]
    d, e, f = two[..., 0], two[..., 1], two[..., 2]
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d], axis=-1)


def turned(vectors: NDArray[Real], matrix: FloatArray) -> NDArray[Real]:
    """The vectors (..., 3), each times a matrix (3, 3), in the vectors' own precision.

    Written out: a matrix product would go through BLAS, whose results differ from
    machine to machine and whose threads would fight with ours.
    """
    # Column by column: numpy is slow along a last axis of three.
    x, y, z = (np.ascontiguousarray(vectors[..., axis]) for axis in range(3))
    product = np.empty_like(vectors)
    for row, (a, b, c) in enumerate(matrix.astype(vectors.dtype)):
        total = x * a
        total += y * b
        total += z * c
        product[..., row] = total
    return product


def along(vectors: NDArray[Real], direction: ArrayLike) -> NDArray[Real]:
    """(...,): scalar products of vectors (..., 3) with one direction."""
    x, y, z = np.asarray(direction, dtype=vectors.dtype)
    return np.asarray(vectors[..., 0] * x + vectors[..., 1] * y + vectors[..., 2] * z)


def join(meshes: Iterable[Mesh]) -> Mesh:
    """All triangles in one mesh; of no mesh, none."""
    parts = list(meshes)
    if not parts:
        return Mesh(
            np.zeros((0, 3, 3)),
            np.zeros((0, 3, 3)),
            np.zeros((0, SURFACE_COLUMNS), dtype=np.float32),
            np.zeros(0, dtype=np.uint8),
        )
    return Mesh(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.surface for part in parts]),
        np.concatenate([part.tag for part in parts]),
    )
