"""Pixels as one number each: converted, gathered from rectangles, counted by runs.

The pixels of an image are codes, one byte each, or colours: red, green, blue. Either
way `values_of` gives one number per pixel, which can be compared, and a table with an
entry for each of the 2^24 colours gives the code of a colour. The codes are defined in
`filter_core.segmentation.codes`.

Counting uses that a segmentation consists of runs, equal pixels side by side, each of
some fifty pixels on average. `run_ends` finds where they end and `run_lengths`
how long they are; one pixel of each is looked up and counts for the whole run.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Literal, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, IntArray, Mask

ChannelOrder: TypeAlias = Literal["rgb", "bgr"]
"""Of three colour channels, in an array or in a file."""

Codes: TypeAlias = NDArray[np.uint8]
"""Small numbers for colours: of some pixels, or a table of those of all 2^24."""

PixelValues: TypeAlias = NDArray[np.int32] | NDArray[np.uint8]
"""Packed colours with 255 in the upper byte, so negative; or codes."""


def values_of(pixels: NDArray[np.uint8]) -> PixelValues:
    """(H, W) uint8 or int32: one number per pixel.

    `pixels` are (H, W) uint8, codes, which are not copied; or (H, W, 3) uint8: red,
    green, blue.
    """
    if pixels.ndim == 2:
        return pixels
    height, width, _ = pixels.shape
    if 0 < height * width <= _CONVERTED_AT_ONCE:
        return cv2.cvtColor(pixels, cv2.COLOR_RGB2BGRA).view(np.int32)[:, :, 0]
    bgra = np.empty((height, width, 4), dtype=np.uint8)
    _convert(pixels, bgra)
    return bgra.view(np.int32)[:, :, 0]


# OpenCV splits larger pictures between threads, which then wait for each other
# whenever the cores are busy with other frames.
_CONVERTED_AT_ONCE: Final = 1 << 16


def _convert(rgb: NDArray[np.uint8], bgra: NDArray[np.uint8]) -> None:
    """Write B, G, R and 255: in memory, a packed colour."""
    height, width, _ = bgra.shape
    pixels = height * width
    if 0 < pixels <= _CONVERTED_AT_ONCE:
        cv2.cvtColor(rgb, cv2.COLOR_RGB2BGRA, dst=bgra)
    elif pixels:
        rows = max(1, _CONVERTED_AT_ONCE // width)
        for top in range(0, height, rows):
            part = slice(top, top + rows)
            cv2.cvtColor(rgb[part], cv2.COLOR_RGB2BGRA, dst=bgra[part])


def sampled(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Some 4096 pixels of an image, evenly spread, (h, w) or (h, w, 3).

    Images of one size are sampled at the same places. Enough to recognise what an image
    is, and much cheaper than looking at all of it.
    """
    step = max(1, int((pixels.shape[0] * pixels.shape[1] / _SAMPLED_PIXELS) ** 0.5))
    return np.ascontiguousarray(pixels[step // 2 :: step, step // 2 :: step])


_SAMPLED_PIXELS: Final = 4096


def gather(
    pixels: NDArray[np.uint8], bounds: IntArray, keep: Mask | None = None
) -> tuple[PixelValues, IntArray]:
    """The values of N rectangles, one after the other (P,); how many each has (N,).

    `bounds` (N, 4) are first column, first row, last column
    + 1, last row + 1, and may be empty; of their pixels those of `keep` (H, W) are
    wanted, by default all.
    """
    regions = [np.s_[y0:y1, x0:x1] for x0, y0, x1, y1 in bounds.tolist()]
    if keep is None and pixels.ndim == 3:
        return _gather_converted(pixels, regions)
    parts = [values_of(pixels[region]) for region in regions]
    if keep is None:
        parts = [part.reshape(-1) for part in parts]
    else:
        parts = [part[keep[r]] for part, r in zip(parts, regions, strict=True)]
    sizes = np.array([len(part) for part in parts], dtype=np.int64)
    values: PixelValues = np.concatenate([*parts, np.empty(0, np.uint8)])
    return values, sizes


def _gather_converted(
    rgb: NDArray[np.uint8], regions: list[tuple[slice, slice]]
) -> tuple[PixelValues, IntArray]:
    """Each rectangle is converted straight into its place, without a copy between."""
    parts = [rgb[region] for region in regions]
    sizes = [part.shape[0] * part.shape[1] for part in parts]
    room = np.empty((sum(sizes), 4), dtype=np.uint8)
    start = 0
    for part, size in zip(parts, sizes, strict=True):
        height, width, _ = part.shape
        _convert(part, room[start : start + size].reshape(height, width, 4))
        start += size
    return room.view(np.int32).reshape(-1), np.array(sizes, dtype=np.int64)


def codes_of(values: PixelValues, table: Codes) -> Codes:
    """The code of each value: of codes themselves, or by the table of 2^24 colours."""
    if values.dtype == np.uint8:
        return values.astype(np.uint8, copy=False)
    # A negative number counts from the end of the table's 2^24 rows: wrapping drops
    # the upper byte, which is 255, for free.
    return table.take(values, mode="wrap")


def count_codes(pixels: NDArray[np.uint8], table: Codes) -> IntArray:
    """(256,) int64, px: how many pixels of an image have each code.

    `pixels` are as for `values_of`; `table`, (2^24,) uint8, has the code of each packed
    colour, and is not looked at if `pixels` are codes.

    Notes
    -----
    Exact. A segmentation consists of runs of one colour; only the last pixel of each
    is looked up and counts for the whole run. Images without runs are looked up whole.
    """
    counts = np.zeros(256, dtype=np.int64)
    codes: list[Codes] = []
    lengths: list[IntArray] = []
    for strip in _strips(pixels):
        ends = run_ends(strip)
        if len(ends) * _SHORTEST_MEAN_RUN > len(strip):
            counts += np.bincount(codes_of(strip, table), minlength=256)
        else:
            codes.append(codes_of(strip[ends], table))
            lengths.append(run_lengths(ends))
    if codes:
        # Weights are float64: exact for whole numbers of pixels.
        weighed = np.bincount(
            np.concatenate(codes), weights=np.concatenate(lengths), minlength=256
        )
        counts += weighed.astype(np.int64)
    return counts


# A strip's temporaries stay in the processor's cache.
_STRIP_PIXELS: Final = 1 << 17

# Finding a run costs about as much as looking up this many pixels.
_SHORTEST_MEAN_RUN: Final = 4


def _strips(pixels: NDArray[np.uint8]) -> Iterator[PixelValues]:
    """Whole rows of values, flat; valid until the next strip is asked for."""
    rows = max(1, _STRIP_PIXELS // pixels.shape[1])
    for top in range(0, len(pixels), rows):
        # Contiguous already, unless an array of tags was given as a view.
        strip: PixelValues = values_of(pixels[top : top + rows]).reshape(-1)
        yield strip


def occurring_codes(rgb: NDArray[np.uint8], table: Codes) -> list[int]:
    """Which codes of a (2^24,) table occur in a contiguous image, in ascending order.

    Notes
    -----
    Exact, and cheaper than counting: a block of eight pixels that equals the one above
    it adds nothing, so only the others are looked at.
    """
    height, width, _ = rgb.shape
    if width % _BLOCK_PIXELS:
        return _codes_counted(count_codes(rgb, table))
    blocks = rgb.reshape(-1).view(np.uint64).reshape(height, width // _BLOCK_PIXELS, 3)
    changed = blocks[1:] != blocks[:-1]
    new = changed[:, :, 0] | changed[:, :, 1]
    new |= changed[:, :, 2]
    below = blocks[1:].reshape(-1, 3).take(_positions(new), axis=0)
    looked_at = np.concatenate([blocks[0], below]).view(np.uint8)
    values = values_of(looked_at.reshape(1, -1, 3)).reshape(-1)
    last = np.append(np.flatnonzero(values[1:] != values[:-1]), len(values) - 1)
    return _codes_counted(np.bincount(codes_of(values[last], table)))


# Three words of eight bytes.
_BLOCK_PIXELS: Final = 8


def _codes_counted(counts: IntArray) -> list[int]:
    return [int(code) for code in np.flatnonzero(counts)]


def run_ends(flat: PixelValues, stops: IntArray | None = None) -> IntArray:
    """(R,) int64, ascending: the index of the last of each run of equal elements.

    A run also ends before each of `stops`, ascending indexes; 0 is none.
    """
    size = len(flat)
    if not size:
        return np.empty(0, dtype=np.int64)
    # A multiple of eight, as `_positions` likes it.
    last = np.zeros(-(-size // 8) * 8, dtype=np.bool_)
    np.not_equal(flat[1:], flat[:-1], out=last[: size - 1])
    last[size - 1] = True
    if stops is not None:
        last[stops[stops > 0] - 1] = True
    return _positions(last)


def run_lengths(ends: IntArray) -> IntArray:
    """How many elements each of R runs has, (R,) int64.

    `ends` are the indexes of their last elements, as `run_ends` gives them.
    """
    lengths = np.empty_like(ends)
    lengths[:1] = ends[:1] + 1
    np.subtract(ends[1:], ends[:-1], out=lengths[1:])
    return lengths


def _positions(mask: BoolArray) -> IntArray:
    """``flatnonzero`` of a sparse mask, in half the time: eight elements at once."""
    flat = mask.reshape(-1)
    if len(flat) % 8:
        flat = np.append(flat, np.zeros(8 - len(flat) % 8, dtype=np.bool_))
    words = flat.view(np.uint64)
    hit = np.flatnonzero(words != 0)
    inside = np.flatnonzero(words[hit].view(np.bool_))
    positions: IntArray = (hit[inside >> 3] << 3) + (inside & 7)
    return positions
