"""Silhouettes of boxes, and the pixels in them that have a tag the box's class accepts.

A box's outline is the convex hull of its projected corners, or its rectangle if it is
not 3D. Its `Silhouette` is the pixels that the outline touches; its `AcceptedPixels`
are those of an accepted tag. The channels ``ordered``, ``depth`` and ``instance``
measure on these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeAlias

import cv2
import numpy as np

from filter_core.arrays import BoxesXYXY, FloatArray, IntArray, Mask, rows_of
from filter_core.classes import accepts
from filter_core.geometry.boxes import pixel_bounds
from filter_core.geometry.camera import Camera
from filter_core.geometry.projection import hull_points
from filter_core.segmentation.codes import PixelCodes


@dataclass(frozen=True, eq=False)
class Silhouette:
    """The pixels that the outline of one box touches.

    Attributes
    ----------
    row : int
        The box's row in its frame.
    x0, y0, x1, y1 : int, px
        Columns ``x0 .. x1 - 1`` and rows ``y0 .. y1 - 1``.
    inside : (y1 - y0, x1 - x0) bool, or None
        Pixels of the silhouette; None: the whole rectangle.
    centred : (y1 - y0, x1 - x0) bool, or None
        Pixels whose centre is inside the outline. An image samples pixel centres, so no
        other pixel can show the box. None if not requested.
    """

    row: int
    x0: int
    y0: int
    x1: int
    y1: int
    inside: Mask | None = None
    centred: Mask | None = None

    @property
    def region(self) -> tuple[slice, slice]:
        """Rows and columns, to index an image with."""
        return np.s_[self.y0 : self.y1, self.x0 : self.x1]

    @property
    def pixels(self) -> int:
        """How many pixels it touches."""
        if self.inside is None:
            return (self.x1 - self.x0) * (self.y1 - self.y0)
        return int(np.count_nonzero(self.inside))

    def of(self, mask: Mask) -> Mask:
        """The part of a mask of the region that is inside the silhouette."""
        return mask if self.inside is None else mask & self.inside


def frame_silhouettes(
    xyxy: BoxesXYXY,
    vertices: FloatArray,
    camera: Camera | None,
    image_wh: tuple[int, int],
    *,
    centres: bool = False,
) -> list[Silhouette]:
    """The silhouettes of a frame's boxes that are in the image, in their order.

    Parameters
    ----------
    xyxy : (N, 4) float64, px
        Corrected rectangles; boxes with NaN rows have no silhouette.
    vertices : (N, 8, 3) float64, metres
        World corners; NaN rows for boxes given as rectangles.
    camera : Camera or None
        Needed if any box has corners.
    image_wh : (width, height), px
    centres : bool
        Whether to compute `Silhouette.centred`.

    Notes
    -----
    A pixel belongs to a silhouette if the outline touches its square, as the paper's
    rectangles take every pixel they touch. So a box thinner than a pixel has pixels.
    """
    bounds = pixel_bounds(xyxy, image_wh)
    solid = ~np.isnan(vertices).any(axis=(1, 2)) & (camera is not None)
    outlines: list[FloatArray | None] = [None] * len(xyxy)
    if camera is not None and solid.any():
        rows = np.flatnonzero(solid)
        solids = hull_points(vertices[rows], camera)
        for row, points in zip(rows.tolist(), solids, strict=True):
            outlines[row] = points
    there = ~np.isnan(xyxy[:, 0])
    there &= (bounds[:, 0] < bounds[:, 2]) & (bounds[:, 1] < bounds[:, 3])
    hulls = {
        row: outline
        for row, outline in enumerate(outlines)
        if there[row] and outline is not None and len(outline)
    }
    inside = _by_row(touched_pixels, hulls, bounds)
    centred: dict[int, Mask] = {}
    if centres:
        for row in np.flatnonzero(there).tolist():
            # (4, 2) px: the corners of a rectangle
            x0, y0, x1, y1 = xyxy[row].tolist()
            hulls.setdefault(row, np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
        centred = _by_row(centred_pixels, hulls, bounds)
    return [
        Silhouette(row, x0, y0, x1, y1, inside.get(row), centred.get(row))
        for row, (x0, y0, x1, y1) in enumerate(bounds.tolist())
        if there[row]
    ]


def _by_row(
    masks_of: Callable[[Sequence[FloatArray], IntArray], list[Mask]],
    hulls: Mapping[int, FloatArray],
    bounds: IntArray,
) -> dict[int, Mask]:
    """`masks_of` applied to the outlines of some boxes; masks by the boxes' rows."""
    masks = masks_of(list(hulls.values()), bounds[list(hulls)])
    return dict(zip(hulls, masks, strict=True))


def touched_pixels(outlines: Sequence[FloatArray], bounds: IntArray) -> list[Mask]:
    """N of (rows, columns) bool: the pixels that convex hulls touch.

    Each is the hull of some points: `outlines` are N of (P, 2) float64, px; `bounds`,
    (N, 4) int64, are first column, first row, last column + 1, last row + 1 of each.

    Notes
    -----
    A convex shape covers one interval of each row of pixels: from the lowest to the
    highest x that its edges have within that row. The rows of all shapes are computed
    together: most boxes are small, and one at a time would be mostly overhead.
    """
    return _filled(_touched, outlines, bounds)


def centred_pixels(outlines: Sequence[FloatArray], bounds: IntArray) -> list[Mask]:
    """The pixels whose centres lie in the convex hull of some points, or on its edge.

    Parameters and result are those of `touched_pixels`.
    """
    return _filled(_centred, outlines, bounds)


_SpansOf: TypeAlias = "Callable[[_Edges, FloatArray], tuple[FloatArray, FloatArray]]"


def _filled(
    spans_of: _SpansOf, outlines: Sequence[FloatArray], bounds: IntArray
) -> list[Mask]:
    """Masks of N hulls; `spans_of` gives the interval of columns of each row."""
    if not len(outlines):
        return []
    heights = bounds[:, 3] - bounds[:, 1]
    ends = np.cumsum(heights)
    owner = np.repeat(np.arange(len(outlines)), heights)
    top = np.arange(ends[-1]) - (ends - heights - bounds[:, 1])[owner]
    # (N, K, 2) px: the hulls' corners in order, padded by repeating the last one
    hulls = []
    for points in outlines:
        # OpenCV returns None for points that coincide; as an array, 0-dimensional.
        corners = np.asarray(cv2.convexHull(points.astype(np.float32)))
        hulls.append(corners[:, 0] if corners.ndim else points[:1])
    padded = np.empty((len(hulls), max(map(len, hulls)), 2))
    for row, hull in enumerate(hulls):
        padded[row, : len(hull)] = hull
        padded[row, len(hull) :] = hull[-1]
    # The columns that a hull covers in each row of pixels, a block of rows at a time
    left, right = np.empty(len(owner)), np.empty(len(owner))
    edges, top = _Edges.of(padded), top.astype(np.float64)
    for start in range(0, len(owner), _ROWS_AT_ONCE):
        part = np.s_[start : start + _ROWS_AT_ONCE]
        left[part], right[part] = spans_of(edges.of_hulls(owner[part]), top[part, None])
    masks: list[Mask] = []
    for (x0, _, x1, _), end, height in zip(
        bounds.tolist(), ends.tolist(), heights.tolist(), strict=True
    ):
        rows, columns = np.s_[end - height : end], np.arange(x0, x1)
        mask = columns >= left[rows, None]
        mask &= columns < right[rows, None]
        masks.append(mask)
    return masks


_ROWS_AT_ONCE: Final = 1 << 13
"""Rows of pixels per block: keeps temporary arrays at a few hundred KiB."""


def _touched(edges: _Edges, top: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns that hulls touch in rows of pixels with upper edge `top`, (R, 1)."""
    bottom = top + 1
    nearest, farthest = edges.range_of(
        (edges.low_y < bottom) & (edges.high_y >= top),
        edges.x_at(np.clip(top, edges.low_y, edges.high_y)),
        edges.x_at(np.clip(bottom, edges.low_y, edges.high_y)),
    )
    left = np.floor(nearest)
    return left, np.maximum(np.ceil(farthest), left + 1)


def _centred(edges: _Edges, top: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns whose pixel centres hulls hold, in rows with upper edge `top`, (R, 1).

    Returns the first column and the last one + 1; the interval may be empty.
    """
    middle = top + 0.5
    crossed = (edges.low_y <= middle) & (edges.high_y >= middle)
    first = edges.x_at(middle)
    nearest, farthest = edges.range_of(crossed, first, first)
    return np.ceil(nearest - 0.5), np.floor(farthest - 0.5) + 1


@dataclass(frozen=True, eq=False)
class _Edges:
    """The edges of hulls, from each corner to the next; all (N, K), px."""

    x: FloatArray
    y: FloatArray
    end_x: FloatArray
    low_y: FloatArray
    high_y: FloatArray
    slope: FloatArray

    @classmethod
    def of(cls, hulls: FloatArray) -> _Edges:
        x, y = hulls[..., 0], hulls[..., 1]
        end_x, end_y = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
        slope = (end_x - x) / np.where(end_y == y, 1.0, end_y - y)
        return cls(x, y, end_x, np.minimum(y, end_y), np.maximum(y, end_y), slope)

    def of_hulls(self, rows: IntArray) -> _Edges:
        """The edges of the hulls in `rows`, which may have duplicates."""
        return rows_of(self, rows)

    def x_at(self, y: FloatArray) -> FloatArray:
        """The x at height `y` of each edge, or of the line through it."""
        return self.x + (y - self.y) * self.slope

    def range_of(
        self, crossed: Mask, first: FloatArray, second: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Least and greatest x of the edges that are `crossed`.

        A horizontal edge counts from one end to the other.
        """
        second = np.where(self.low_y == self.high_y, self.end_x, second)
        nearest = np.where(crossed, np.minimum(first, second), np.inf).min(axis=1)
        farthest = np.where(crossed, np.maximum(first, second), -np.inf).max(axis=1)
        return nearest, farthest


@dataclass(frozen=True, eq=False)
class AcceptedPixels:
    """The accepted pixels of one box: those whose tag its class accepts.

    Attributes
    ----------
    mask : (h, w) bool
        Accepted pixels inside the silhouette; the shape is that of its region.
    around : (h, w) bool, or None
        Accepted pixels anywhere in the region; None: the same as `mask`.
    """

    silhouette: Silhouette
    mask: Mask
    around: Mask | None = None

    @cached_property
    def count(self) -> int:
        """How many there are, px."""
        return int(np.count_nonzero(self.mask))

    @cached_property
    def own(self) -> Mask:
        """The accepted pixels that can show the box itself.

        Their centres are inside its outline. All of them, if it is too thin for that.
        """
        if self.silhouette.centred is None:
            return self.mask
        centred = self.mask & self.silhouette.centred
        return centred if centred.any() else self.mask


def accepted_pixels(
    silhouettes: Sequence[Silhouette],
    codes: PixelCodes,
    accept_mask: IntArray,
    ignore: Mask | None = None,
) -> list[AcceptedPixels]:
    """For each silhouette, its pixels of an accepted tag.

    Parameters
    ----------
    silhouettes : of the boxes that are in the image
    codes : PixelCodes of the segmentation
    accept_mask : (N,) int64
        Bit t is set if the box's class accepts tag t.
    ignore : (H, W) bool, optional
        True: the pixel never counts.
    """
    tables = {
        mask: accepts(mask, codes.tag_of_code)
        for mask in np.unique(accept_mask).tolist()
    }
    accepted = []
    for silhouette in silhouettes:
        table = tables[int(accept_mask[silhouette.row])]
        box = silhouette.x0, silhouette.y0, silhouette.x1, silhouette.y1
        around = table[codes.crop(*box)]
        if ignore is not None:
            around = around & ~ignore[silhouette.region]
        accepted.append(AcceptedPixels(silhouette, silhouette.of(around), around))
    return accepted
