"""Triangles in space: corners, normals, paint and tag. Knows no camera."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.demo.paint import SURFACE_COLUMNS, Paint
from filter_core.types import FloatArray


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
        turn, shift = matrix[:3, :3].T, matrix[:3, 3]
        return Mesh(
            self.corners @ turn + shift, self.normals @ turn, self.surface, self.tag
        )

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Mesh:
        """The mesh somewhere else."""
        shifted = self.corners + np.array([x, y, z])
        return Mesh(shifted, self.normals, self.surface, self.tag)

    def mirrored(self) -> Mesh:
        """The mesh on the other side of the plane y = 0."""
        flip = np.array([1.0, -1.0, 1.0])
        return Mesh(self.corners * flip, self.normals * flip, self.surface, self.tag)

    def both_sides(self) -> Mesh:
        """The mesh and its mirror image."""
        return join([self, self.mirrored()])

    def subset(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> Mesh:
        """Some of the triangles."""
        return Mesh(
            self.corners[chosen],
            self.normals[chosen],
            self.surface[chosen],
            self.tag[chosen],
        )


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
