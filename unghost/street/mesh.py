"""Triangle meshes, and the basic shapes from which the street is built.

A `Mesh` is a set of triangles with normals, paint and tag. Blocks, tubes, balls, sheets
and lofts make meshes. A loft stretches a skin over rings of points. Vehicles are
symmetrical, so their rings are given by the right halves.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from filter_core.arrays import FloatArray
from unghost.street.paint import DYE_COLUMN, SURFACE_COLUMNS, Float32, Paint, f32

Real = TypeVar("Real", np.float32, np.float64)
Point: TypeAlias = tuple[float, float, float]
"""x, y, z, metres."""
Block: TypeAlias = tuple[ArrayLike, ArrayLike, Paint]
"""Two opposite corners of an upright box, and its paint."""
_CREASE_COSINE: Final = 0.68
"""Faces that meet at less than about 47 degrees share a smooth normal."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A set of triangles.

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
        axes = np.ascontiguousarray(self.corners.reshape(-1, 3).T)
        return axes.min(axis=1), axes.max(axis=1)

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
        """The mesh moved, without a turn."""
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


def cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Vector products along the last axis; numpy's own takes four times as long."""
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    d, e, f = second[..., 0], second[..., 1], second[..., 2]
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d], axis=-1)


def turned(vectors: NDArray[Real], matrix: FloatArray) -> NDArray[Real]:
    """The vectors (..., 3), each times a matrix (3, 3), in their own precision.

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


def dot(first: Float32, second: ArrayLike) -> Float32:
    """(N,): scalar products of vectors (3, N) with others, or with one direction."""
    x, y, z = f32(second)
    return np.asarray(first[0] * x + first[1] * y + first[2] * z)


def block(low: ArrayLike, high: ArrayLike, paint: Paint, tag: int) -> Mesh:
    """An upright box between two opposite corners."""
    (x0, y0, z0), (x1, y1, z1) = np.asarray(low, float), np.asarray(high, float)
    quads = np.array(
        [
            [(x0, y0, z0), (x0, y1, z0), (x0, y1, z1), (x0, y0, z1)],
            [(x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1)],
            [(x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)],
            [(x0, y1, z0), (x1, y1, z0), (x1, y1, z1), (x0, y1, z1)],
            [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)],
            [(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)],
        ]
    )
    axes = np.array(
        [[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], float
    )
    normals = np.repeat(axes[:, None, :], 4, axis=1)
    return _quads(quads, normals, paint, tag)


def blocks(rows: Iterable[Block], tag: int) -> Mesh:
    """Upright boxes of one tag."""
    return join(block(low, high, paint, tag) for low, high, paint in rows)


def tube(
    start: ArrayLike,
    end: ArrayLike,
    radius: float | tuple[float, float],
    look: tuple[Paint, int],
    sides: int = 8,
) -> Mesh:
    """A round bar, or a cone where the two radii differ; closed at both ends."""
    first, last = np.asarray(start, float), np.asarray(end, float)
    thick, thin = radius if isinstance(radius, tuple) else (radius, radius)
    axis = (last - first) / np.linalg.norm(last - first)
    # Two directions that are square to it
    other = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0, 0])
    across = cross(axis, other)
    across /= np.linalg.norm(across)
    up = cross(axis, across)
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False) + np.pi / sides
    circle = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * up
    rings = np.stack([first + thick * circle, last + thin * circle])
    closed = np.concatenate([rings, rings[:, :1]], axis=1)
    out = np.concatenate([circle, circle[:1]])
    skin = _quads(_cells(closed), _cells(np.stack([out, out])), *look)
    centres = np.broadcast_to(np.stack([first, last])[:, None], rings.shape)
    caps = np.stack([centres, closed[:, :-1], closed[:, 1:]], axis=2)
    out = np.broadcast_to(np.stack([-axis, axis])[:, None, None], caps.shape)
    return join([skin, Mesh.of(caps.reshape(-1, 3, 3), out.reshape(-1, 3, 3), *look)])


def ball(
    centre: ArrayLike, radii: ArrayLike, look: tuple[Paint, int], sides: int = 10
) -> Mesh:
    """An ellipsoid."""
    rings = max(4, sides // 2 + 1)
    tilt = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    turn = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    unit = np.stack(
        [
            np.cos(tilt)[:, None] * np.cos(turn),
            np.cos(tilt)[:, None] * np.sin(turn),
            np.sin(tilt)[:, None] * np.ones(sides),
        ],
        axis=-1,
    )
    grid = np.concatenate([unit, unit[:, :1]], axis=1)
    scale = np.broadcast_to(np.asarray(radii, float), (3,))
    quads = _cells(grid * scale + np.asarray(centre, float))
    slopes = grid / scale
    normals = _cells(slopes / np.linalg.norm(slopes, axis=-1, keepdims=True))
    return _quads(quads, normals, look[0], look[1])


def wheel_ring(
    centre: ArrayLike, radius: float, thick: float, look: tuple[Paint, int]
) -> Mesh:
    """A tyre that one can look through, rolling along x."""
    around = np.linspace(0, 2 * np.pi, 21)
    across = np.linspace(0, 2 * np.pi, 6)
    out = np.stack([np.cos(around), np.zeros(21), np.sin(around)], axis=-1)
    side = np.array([0.0, 1.0, 0.0])
    normals = (
        np.cos(across)[None, :, None] * out[:, None]
        + np.sin(across)[None, :, None] * side
    )
    points = out[:, None] * (radius - thick) + normals * thick
    quads = _cells(points + np.asarray(centre, float))
    return _quads(quads, _cells(normals), look[0], look[1])


def sheet(corners: ArrayLike, normal: ArrayLike, paint: Paint, tag: int) -> Mesh:
    """Flat quads (..., 4, 3), visible from the side that their normal points to."""
    quads = np.asarray(corners, float).reshape(-1, 4, 3)
    normals = np.broadcast_to(np.asarray(normal, float), quads.shape)
    return _quads(quads, normals, paint, tag)


def loft(
    rings: FloatArray, paints: Sequence[Sequence[Paint]], tag: int, *, caps: bool = True
) -> Mesh:
    """A skin stretched over closed rings of points.

    `rings` are (S, K, 3): S sections with K points each. `paints` have rows for the S -
    1 stretches and columns for the K strips; the last ones are repeated as needed.
    `caps` close the first and the last ring.
    """
    closed = np.concatenate([rings, rings[:, :1]], axis=1)
    quads, faces = _cells(closed), _face_normals(closed, rings)
    normals = _creased(faces).reshape(-1, 4, 3)
    of_paint: dict[tuple[int, int], list[int]] = {}
    for place, (stretch, strip) in enumerate(np.ndindex(*faces.shape[:2])):
        row = min(stretch, len(paints) - 1)
        column = min(strip, len(paints[row]) - 1)
        of_paint.setdefault((row, column), []).append(place)
    parts = []
    for (row, column), chosen in of_paint.items():
        flat = np.array(chosen)
        parts.append(_quads(quads[flat], normals[flat], paints[row][column], tag))
    for end, next_one in ((0, 1), (-1, -2)) if caps else ():
        outwards = (rings[end] - rings[next_one]).mean(axis=0)
        # The paint of the ring's middle: its first strips are what lies underneath.
        paint = paints[end][len(paints[end]) // 3]
        parts.append(_cap(rings[end], outwards, paint, tag))
    return join(parts)


def section(x: float, half: FloatArray) -> FloatArray:
    """The ring of `half` at one place along a vehicle."""
    closed = ring(half)
    return np.column_stack([np.full(len(closed), x), closed])


def ring(half: FloatArray) -> FloatArray:
    """A closed ring (K, 2) of y, z from its right half, which ends on the middle."""
    left = half[-2:0:-1] * np.array([-1.0, 1.0])
    return np.concatenate([half, left])


def mirrored_columns(paints: list[Paint]) -> list[Paint]:
    """Paints of a ring's strips, from those of its right half."""
    return [*paints, *reversed(paints)]


def _cells(grid: FloatArray) -> FloatArray:
    """(S, K, 3) points to (cells, 4, 3) quads, in the order of going around."""
    quads = np.stack(
        [grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2
    )
    return quads.reshape(-1, 4, 3)


def _face_normals(closed: FloatArray, rings: FloatArray) -> FloatArray:
    """(S-1, K, 3): normals of the skin's quads, outwards from the rings' centres."""
    diagonal = closed[1:, 1:] - closed[:-1, :-1]
    other = closed[:-1, 1:] - closed[1:, :-1]
    normals = cross(diagonal, other)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = normals / np.maximum(length, 1e-12)
    centres = rings.mean(axis=1)
    middle = (centres[1:] + centres[:-1])[:, None] / 2
    quad_middle = (closed[1:, 1:] + closed[:-1, :-1]) / 2
    # One sign for the whole skin: face by face it would flip on hollow shapes.
    outwards = np.sum(normals * (quad_middle - middle) * length) >= 0
    return np.asarray(normals if outwards else -normals)


def _creased(faces: FloatArray) -> FloatArray:
    """(S-1, K, 4, 3): corner normals, smooth across gentle edges only."""
    around = np.concatenate([faces[:, -1:], faces, faces[:, :1]], axis=1)
    grid = np.pad(around, ((1, 1), (0, 0), (0, 0)))
    stretches, strips = faces.shape[:2]
    corners = []
    for row, column in ((0, 0), (1, 0), (1, 1), (0, 1)):
        total = np.zeros_like(faces)
        for down in (row, row + 1):
            for right in (column, column + 1):
                near = grid[down : down + stretches, right : right + strips]
                gentle = np.sum(near * faces, axis=-1, keepdims=True) > _CREASE_COSINE
                total += np.where(gentle, near, 0.0)
        length = np.linalg.norm(total, axis=-1, keepdims=True)
        corners.append(np.where(length > 1e-9, total / np.maximum(length, 1e-9), faces))
    return np.stack(corners, axis=2)


def _cap(ring: FloatArray, outwards: FloatArray, paint: Paint, tag: int) -> Mesh:
    count = len(ring)
    centre = np.broadcast_to(ring.mean(axis=0), (count, 3))
    corners = np.stack([centre, ring, np.roll(ring, -1, axis=0)], axis=1)
    area = cross(ring - centre, np.roll(ring, -1, axis=0) - centre).sum(axis=0)
    normal = area / max(float(np.linalg.norm(area)), 1e-12)
    if normal @ outwards < 0:
        normal = -normal
    return Mesh.of(corners, np.broadcast_to(normal, corners.shape).copy(), paint, tag)


def _quads(quads: FloatArray, normals: FloatArray, paint: Paint, tag: int) -> Mesh:
    """(Q, 4, 3) quads as twice as many triangles; collapsed ones are left out."""
    halves = [[0, 1, 2], [0, 2, 3]]
    corners = np.concatenate([quads[:, half] for half in halves])
    tilted = np.concatenate([normals[:, half] for half in halves])
    area = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    real = np.linalg.norm(area, axis=1) > 1e-9
    return Mesh.of(corners[real], tilted[real], paint, tag)
