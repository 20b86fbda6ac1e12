"""A z-buffer: finds the nearest triangle at each pixel, for many triangles at once.

`to_screen` projects the triangles that a camera may see, `draw` draws them on a canvas.
"Nearness" is a number that is linear on the screen and grows towards the eye: 1 / depth
for a camera, the height towards the sun for its shadows.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, FloatArray, IntArray
from filter_core.geometry.camera import Camera
from unghost.street.mesh import cross, turned

_LARGE_PX: Final = 6000
"""From this window on, a triangle is drawn by itself: whole-array steps pay off."""
_LARGE_AT_ONCE: Final = 512
_FRAGMENTS_AT_ONCE: Final = 600_000
_SLIVER_PX: Final = 1e-6
NEAR: Final = 0.1
"""Metres; nothing nearer is drawn, as in Unreal Engine."""


@dataclass(eq=False)
class Canvas:
    """The nearest surface found so far.

    Attributes
    ----------
    nearness : (H, W) float32
    winner : (H, W) int32
        Number of the nearest triangle; its first value where none was drawn.
    """

    nearness: NDArray[np.float32]
    winner: NDArray[np.int32]

    @classmethod
    def blank(cls, width: int, height: int, nearness: float = 0.0) -> Canvas:
        """A canvas where nothing has been drawn (winner -1)."""
        return cls(
            np.full((height, width), nearness, dtype=np.float32),
            np.full((height, width), -1, dtype=np.int32),
        )


def draw(canvas: Canvas, screen: FloatArray, numbers: IntArray) -> None:
    """Draw triangles into the canvas; the nearest wins. Of equals any may.

    `screen` is (T, 3, 3) float64: per corner u px, v px, nearness. A pixel is covered
    if its centre is. `numbers` are (T,) int64, which `Canvas.winner` gets.
    """
    height, width = canvas.winner.shape
    edges, window_px, nearest = _prepare(screen, numbers, width, height)
    large = np.flatnonzero(window_px > _LARGE_PX)
    for begin in range(0, len(large), _LARGE_AT_ONCE):
        _draw_large(canvas, edges.part(large[begin : begin + _LARGE_AT_ONCE]))
    small = np.flatnonzero((window_px > 0) & (window_px <= _LARGE_PX))
    # From near to far: most of what comes later is then hidden and dropped early.
    small = small[np.argsort(-nearest[small], kind="stable")]
    ends = np.cumsum(window_px[small])
    steps = np.arange(0, ends[-1] if len(ends) else 0, _FRAGMENTS_AT_ONCE)
    cuts = [*np.searchsorted(ends, steps), len(small)]
    for begin, end in itertools.pairwise(cuts):
        _draw_small(canvas, edges.part(small[begin:end]))


@dataclass(frozen=True, eq=False)
class _Edges:
    """Triangles with corners sorted from top to bottom, and their planes."""

    number: IntArray
    u: FloatArray
    v: FloatArray
    slope_u: FloatArray
    slope_v: FloatArray
    offset: FloatArray

    def part(self, chosen: IntArray | slice) -> _Edges:
        return _Edges(
            self.number[chosen],
            self.u[chosen],
            self.v[chosen],
            self.slope_u[chosen],
            self.slope_v[chosen],
            self.offset[chosen],
        )


def _prepare(
    screen: FloatArray, numbers: IntArray, width: int, height: int
) -> tuple[_Edges, IntArray, FloatArray]:
    order = np.argsort(screen[:, :, 1], axis=1, kind="stable")
    points = np.take_along_axis(screen, order[:, :, None], axis=1)
    u, v, w = points[..., 0], points[..., 1], points[..., 2]
    du1, dv1, dw1 = (a[:, 1] - a[:, 0] for a in (u, v, w))
    du2, dv2, dw2 = (a[:, 2] - a[:, 0] for a in (u, v, w))
    area = du1 * dv2 - du2 * dv1
    sound = np.abs(area) > _SLIVER_PX
    safe = np.where(sound, area, 1.0)
    slope_u = (dw1 * dv2 - dw2 * dv1) / safe
    slope_v = (du1 * dw2 - du2 * dw1) / safe
    offset = w[:, 0] - slope_u * u[:, 0] - slope_v * v[:, 0]
    rows = _rows(v[:, 2], height) - _rows(v[:, 0], height)
    columns = _rows(u.max(axis=1), width) - _rows(u.min(axis=1), width)
    window = np.where(sound, rows * columns, 0)
    edges = _Edges(numbers, u, v, slope_u, slope_v, offset)
    return edges, window, w.max(axis=1)


def _rows(position: FloatArray, limit: int) -> IntArray:
    """The first pixel whose centre is not before a position, inside the canvas."""
    return np.clip(np.ceil(position - 0.5), 0, limit).astype(np.int64)


def _spans(edges: _Edges, width: int, height: int) -> tuple[IntArray, ...]:
    """(triangle, row, first column, end column) of each row of each triangle."""
    u, v = edges.u, edges.v
    first = _rows(v[:, 0], height)
    count = _rows(v[:, 2], height) - first
    owner = np.repeat(np.arange(len(count)), count)
    row = np.arange(len(owner)) + np.repeat(first - (np.cumsum(count) - count), count)
    y = row + 0.5
    # Columns per row along the long edge, the upper and the lower one.
    run = np.stack([u[:, 2] - u[:, 0], u[:, 1] - u[:, 0], u[:, 2] - u[:, 1]], axis=1)
    rise = np.stack([v[:, 2] - v[:, 0], v[:, 1] - v[:, 0], v[:, 2] - v[:, 1]], axis=1)
    level = rise < 1e-12
    slopes = np.where(level, 0.0, run / np.where(level, 1.0, rise))
    long_x = u[owner, 0] + (y - v[owner, 0]) * slopes[owner, 0]
    above = y < v[owner, 1]
    corner = np.where(above, 0, 1)
    short_x = u[owner, corner] + (y - v[owner, corner]) * slopes[owner, corner + 1]
    begin = _rows(np.minimum(long_x, short_x), width)
    end = _rows(np.maximum(long_x, short_x), width)
    return owner, row, begin, end


def _draw_small(canvas: Canvas, edges: _Edges) -> None:
    height, width = canvas.winner.shape
    owner, row, begin, end = _spans(edges, width, height)
    kept = np.flatnonzero(end > begin)
    owner, row, begin = owner[kept], row[kept], begin[kept]
    length = end[kept] - begin
    start = np.cumsum(length) - length
    slope = edges.slope_u[owner]
    at_begin = slope * (begin + 0.5) + edges.slope_v[owner] * (row + 0.5)
    at_begin = (at_begin + edges.offset[owner]).astype(np.float32)
    span = np.repeat(np.arange(len(owner), dtype=np.int32), length)
    step = np.arange(len(span), dtype=np.int32) - start.astype(np.int32)[span]
    pixel = (row * width + begin).astype(np.int32)[span] + step
    # int32 times float32 would be float64, and never equal what is stored.
    run = step.astype(np.float32)
    nearness = at_begin[span] + slope.astype(np.float32)[span] * run
    nearest, winner = canvas.nearness.reshape(-1), canvas.winner.reshape(-1)
    seen = np.flatnonzero(nearness > nearest[pixel])
    pixel, nearness, span = pixel[seen], nearness[seen], span[seen]
    np.maximum.at(nearest, pixel, nearness)
    won = np.flatnonzero(nearest[pixel] == nearness)
    winner[pixel[won]] = edges.number[owner[span[won]]]


def _draw_large(canvas: Canvas, edges: _Edges) -> None:
    """Draw triangles one by one, each with all pixels of its window at once."""
    height, width = canvas.winner.shape
    owner, rows, begins, ends = _spans(edges, width, height)
    cuts = np.searchsorted(owner, np.arange(len(edges.number) + 1)).tolist()
    for triangle, (first, last) in enumerate(itertools.pairwise(cuts)):
        row, begin, end = rows[first:last], begins[first:last], ends[first:last]
        if first == last or not (end > begin).any():
            continue
        left, right = int(begin.min()), int(end.max())
        window = np.s_[int(row[0]) : int(row[-1]) + 1, left:right]
        column = np.arange(left, right)
        along = (edges.slope_u[triangle] * (column + 0.5)).astype(np.float32)
        down = (edges.slope_v[triangle] * (row + 0.5) + edges.offset[triangle]).astype(
            np.float32
        )
        nearness = down[:, None] + along
        nearest = canvas.nearness[window]
        seen = nearness > nearest
        seen &= column >= begin[:, None]
        seen &= column < end[:, None]
        np.copyto(nearest, nearness, where=seen)
        np.copyto(canvas.winner[window], np.int32(edges.number[triangle]), where=seen)


def to_screen(
    corners: FloatArray, normals: FloatArray, camera: Camera, two_sided: BoolArray
) -> tuple[FloatArray, IntArray]:
    """Project triangles (T, 3, 3) of the world, without those that cannot be seen.

    Those that are `two_sided` (T,) are also seen from behind. Returns (N, 3, 3)
    float64, per corner u px, v px, 1 / depth, and (N,) int64, the triangle that each
    comes from; one cut by the near plane may come twice.
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


def _products(a: FloatArray, b: FloatArray) -> FloatArray:
    """(N,) scalar products of pairs of vectors."""
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])


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
