"""Counting pixels inside boxes by the cheaper of two exact strategies.

`count_pixels` and `count_codes_in` choose it by an estimate of the time; which is
cheaper depends on how much of the image the boxes cover.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np

from filter_core.arrays import IntArray, Mask
from filter_core.images.pixels import gather, run_ends, run_lengths
from filter_core.segmentation.codes import PixelCodes

# Nanoseconds, measured with benchmarks/bench_filter.py; only their ratios matter.
_NS_PER_BOX: Final = 1_800.0

_NS_PER_BOX_PIXEL: Final = 1.1

_NS_PER_CODE_AND_PIXEL: Final = 0.28

_NS_PER_IMAGE_PIXEL: Final = 1.6

_NS_PER_CODE_AND_BOX: Final = 12.0

_CHUNK_PIXELS: Final = 1 << 20
"""Pixels gathered at a time, which limits memory to a few megabytes."""


@dataclass(frozen=True, eq=False)
class Regions:
    """N rectangles of pixels of one image.

    `bounds` (N, 4) are first column, first row, last column + 1, last row + 1; they may
    be empty. Of the pixels those of `keep` (H, W) count; None: all do.
    """

    codes: PixelCodes
    bounds: IntArray
    keep: Mask | None = None

    def __len__(self) -> int:
        return len(self.bounds)

    @cached_property
    def areas(self) -> IntArray:
        """(N,) int64: pixels of each rectangle, whether they count or not."""
        x0, y0, x1, y1 = self.bounds.T
        areas: IntArray = (x1 - x0) * (y1 - y0)
        return areas


def count_pixels(regions: Regions) -> IntArray:
    """(N,) int64: the pixels of each of N rectangles that are not ignored."""
    if regions.keep is None:
        return regions.areas
    kept = PixelCodes.of_tags(regions.keep.view(np.uint8), 2, np.ones(2, np.int64))
    return count_codes_in(Regions(kept, regions.bounds), [1])[:, 0]


def count_codes_in(regions: Regions, codes: Sequence[int]) -> IntArray:
    """(N, K) int64, px: how many pixels of N rectangles have each of K codes.

    The codes are different ones.

    Notes
    -----
    The rectangles' own pixels are counted, or summed-area tables [1]_ of the whole
    image are built, one per code: whichever is expected to be cheaper.

    References
    ----------
    .. [1] F. C. Crow, "Summed-area tables for texture mapping", SIGGRAPH 1984.
    """
    height, width = regions.codes.hw
    by_pixels = len(regions) * _NS_PER_BOX
    by_pixels += float(regions.areas.sum()) * _NS_PER_BOX_PIXEL
    by_tables = height * width * _NS_PER_IMAGE_PIXEL
    by_tables += height * width * len(codes) * _NS_PER_CODE_AND_PIXEL
    by_tables += len(regions) * len(codes) * _NS_PER_CODE_AND_BOX
    if by_tables < by_pixels:
        return count_by_tables(regions, codes)
    return count_by_pixels(regions, codes)


def count_by_pixels(regions: Regions, codes: Sequence[int]) -> IntArray:
    """Counts from the rectangles' own pixels, in chunks of bounded size."""
    counts = np.zeros((len(regions), len(codes)), dtype=np.int64)
    column = np.full(256, len(codes), dtype=np.int64)
    column[list(codes)] = np.arange(len(codes))
    width = len(codes) + 1
    for chunk in _chunks(regions.areas):
        bounds = regions.bounds[chunk]
        values, sizes = gather(regions.codes.pixels, bounds, regions.keep)
        stops = np.cumsum(sizes)
        ends = run_ends(values, stops)
        box = np.searchsorted(stops, ends, side="right")
        chunk_counts = np.bincount(
            box * width + column[regions.codes.codes_of(values[ends])],
            # Weights are float64: exact for whole numbers of pixels.
            weights=run_lengths(ends),
            minlength=len(bounds) * width,
        )
        counts[chunk] = chunk_counts.reshape(-1, width)[:, :-1]
    return counts


def count_by_tables(regions: Regions, codes: Sequence[int]) -> IntArray:
    """Counts from one summed-area table per code."""
    height, width = regions.codes.hw
    plane = regions.codes.crop(0, 0, width, height)
    x0, y0, x1, y1 = regions.bounds.T
    row = width + 1
    corners = np.stack([y1 * row + x1, y1 * row + x0, y0 * row + x1, y0 * row + x0])
    counts = np.empty((len(codes), len(regions)), dtype=np.int64)
    for index, code in enumerate(codes):
        hit = plane == code
        if regions.keep is not None:
            hit &= regions.keep
        # Exact: int32 holds the pixels of any image that may be opened.
        table = np.asarray(cv2.integral(hit.view(np.uint8)), np.int32).reshape(-1)
        bottom_right, bottom_left, top_right, top_left = table.take(corners)
        counts[index] = bottom_right - bottom_left - top_right + top_left
    transposed: IntArray = counts.T
    return transposed


def _chunks(areas: IntArray) -> Iterator[slice]:
    """Ranges of boxes with about `_CHUNK_PIXELS` pixels, each of at least one box."""
    total = np.cumsum(areas)
    starts = [0]
    if len(areas) and total[-1] > _CHUNK_PIXELS:
        starts += (np.flatnonzero(np.diff(total // _CHUNK_PIXELS)) + 1).tolist()
    for start, stop in zip(starts, [*starts[1:], len(areas)], strict=True):
        if start < stop:
            yield slice(start, stop)
