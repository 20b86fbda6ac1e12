"""Pixels that never count, such as the ego vehicle's own bonnet.

`read_ignore_mask` makes a boolean mask of the image's size, from a picture or from
polygons.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import cv2
import numpy as np

from filter_core.arrays import BoolArray, FloatArray, Mask
from filter_core.errors import FilterError, ImageError, file_context
from filter_core.images.decoding import decode_image
from filter_core.images.header import MAX_SIDE, read_image_header, require_size

Polygon: TypeAlias = Sequence[Sequence[float]]
"""Corners ``[x, y]`` in px; the last is joined to the first."""


class IgnoreMaskError(FilterError):
    """Polygons that cannot be drawn."""

    code = "bad_ignore_mask"


def read_ignore_mask(source: bytes | Sequence[Polygon], wh: tuple[int, int]) -> Mask:
    """(H, W) bool: the pixels that never count.

    Parameters
    ----------
    source : bytes or a sequence of polygons
        An image file of the frame's size, in which a pixel that is not black is
        ignored (alpha is not looked at); or polygons, of which any may contain it.
    wh : (width, height) of the image, px

    Raises
    ------
    ImageError
        Not a PNG or JPEG that can be decoded, or of another size.
    IgnoreMaskError
        A polygon of fewer than three corners, or a corner that is not two numbers.

    Notes
    -----
    A pixel belongs to a polygon if its centre lies inside, by the even-odd rule: so
    polygons that share an edge share no pixel.
    """
    if isinstance(source, bytes):
        with file_context("ignore_mask"):
            header = read_image_header(source, max_side=max(MAX_SIDE, *wh))
        require_size(header, wh, what="the ignore mask", than="the image")
        with file_context("ignore_mask"):
            pixels = decode_image(source, header, cv2.IMREAD_UNCHANGED)
        if pixels is None:
            raise ImageError("the ignore mask cannot be decoded: it is damaged")
        if pixels.ndim == 2:
            return np.asarray(pixels != 0)
        return np.asarray((pixels[:, :, :3] != 0).any(axis=2))
    mask = np.zeros((wh[1], wh[0]), dtype=np.bool_)
    for index, polygon in enumerate(source):
        where = f"/ignore_mask/{index}"
        try:
            corners = np.asarray(polygon, dtype=np.float64)
        except (TypeError, ValueError):
            corners = np.empty(0)
        if corners.ndim != 2 or corners.shape[1:] != (2,) or len(corners) < 3:
            raise IgnoreMaskError(
                f"polygon {index}: expected at least three corners [x, y]",
                pointer=where,
            )
        if not np.isfinite(corners).all():
            raise IgnoreMaskError(
                f"polygon {index}: expected finite corners, found {corners.tolist()}",
                pointer=where,
            )
        mask |= _polygon_mask(corners, wh)
    return mask


def _polygon_mask(corners: FloatArray, wh: tuple[int, int]) -> BoolArray:
    """Even-odd fill: along a row, each edge that is passed turns inside to outside."""
    width, height = wh
    turns = np.zeros((height, width + 1), dtype=np.int64)
    centres = np.arange(height) + 0.5
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        rows = np.flatnonzero((centres >= y0) != (centres >= y1))
        crossing = x0 + (centres[rows] - y0) * (x1 - x0) / (y1 - y0 or 1.0)
        # The first pixel whose centre is right of the edge.
        columns = np.clip(np.ceil(crossing - 0.5), 0, width).astype(np.int64)
        np.add.at(turns, (rows, columns), 1)
    inside: BoolArray = turns[:, :width].cumsum(axis=1) % 2 == 1
    return inside
