"""What an image looks like by its pixels: a photo, a segmentation, depth, instances.

Only what CARLA and its users write is told; everything else looks like nothing. A few
rows of an image are enough.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, Literal, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.errors import FilterError
from filter_core.formats.reading import open_regular
from filter_core.images.decoding import decode_image
from filter_core.images.header import read_image_header
from filter_core.segmentation.codes import COLOR_BITS, exact_codes
from filter_core.segmentation.palettes import UNCHANGED
from filter_core.segmentation.tags import looks_raw

Look: TypeAlias = Literal["photo", "segmentation", "instances", "depth", "grey"]
"""``grey``: many levels in three equal channels or in one, as in a depth image that was
saved for people, or in a photo without colour."""

_MAX_BYTES: Final = 64 * 1024 * 1024

_ROWS: Final = 64

_KNOWN_SHARE: Final = 0.99
"""Share of the pixels of a segmentation that have colours of CARLA, at least."""

_EQUAL_SHARE: Final = 0.9
"""Share of pixels that equal the next in a row, at least, where objects are flat."""

_LOSSY_STEP: Final = 3

_LOSSY_SHARE: Final = 0.8
"""Share of such small steps between neighbours, at least, in a JPEG of flat colours."""

_FEWEST_COLORS: Final = 256
"""Of a photo, in the rows that are looked at."""

_MOST_TAGS: Final = 48
"""Different grey levels of raw tags, also of a changed CARLA."""

_LAST_LEVEL: Final = 127
"""Largest grey level of raw tags, unless they are multiples of one number."""

_LEAST_FACTOR: Final = 5

_LAST_TAG: Final = 40
"""Largest tag in an instance image, also of a changed CARLA."""

_MOST_INSTANCES: Final = 4096

_NOISE: Final = 24
"""Median step between neighbours in the lowest byte of CARLA's depth, at least."""

_SMOOTH_SHARE: Final = 0.8
"""Share of neighbours whose highest bytes differ by 1 at most, in CARLA's depth."""


def look_of(path: Path) -> Look | None:
    """What an image looks like; None if nothing tells it, or it cannot be read."""
    try:
        with open_regular(path) as file:
            if not 0 < os.fstat(file.fileno()).st_size <= _MAX_BYTES:
                return None
            content = file.read()
        header = read_image_header(content, whole=False)
        pixels = decode_image(content, header, cv2.IMREAD_UNCHANGED)
    except (OSError, FilterError):
        return None
    if pixels is None:
        return None
    look = _look(pixels)
    if header.media_type == "image/png":
        return look
    if look != "photo":
        return None
    # The colours of a JPEG are not exact, so that only a photo can be told; but it may
    # be flat colours, which the lossy format changed.
    rows = pixels[:: max(1, len(pixels) // _ROWS)].astype(np.int16)
    steps = np.abs(rows[:, 1:] - rows[:, :-1]).max(axis=2)
    return None if (steps <= _LOSSY_STEP).mean() >= _LOSSY_SHARE else "photo"


def _look(pixels: NDArray[np.uint8]) -> Look | None:
    """The look of (H, W) or (H, W, 1, 3 or 4) pixels; colours are blue, green, red."""
    step = max(1, len(pixels) // _ROWS)
    rows = pixels[step // 2 :: step]
    if rows.ndim == 3 and rows.shape[2] == 1:
        rows = rows[:, :, 0]
    if rows.dtype != np.uint8:
        return "depth" if rows.ndim == 2 else None
    if rows.ndim == 2:
        return _grey(rows)
    blue, green, red = (np.ascontiguousarray(rows[:, :, n]) for n in range(3))
    if np.array_equal(red, green) and np.array_equal(green, blue):
        return _grey(red)
    rgb = np.dstack([red, green, blue])
    packed = red.astype(np.int32) << 16 | green.astype(np.int32) << 8 | blue
    if not (packed != packed[0, 0]).any():
        return None
    if looks_raw(rgb):
        return "segmentation"
    if (exact_codes(UNCHANGED)[packed & COLOR_BITS] > 0).mean() >= _KNOWN_SHARE:
        return "segmentation"
    return _by_neighbours(packed, red, blue)


def _by_neighbours(
    packed: NDArray[np.int32], red: NDArray[np.uint8], blue: NDArray[np.uint8]
) -> Look | None:
    """Instances are flat; the lowest byte of depth is noise, the highest is flat."""
    if packed.shape[1] < 2:
        return None
    colors = len(np.unique(packed))
    is_flat = (packed[:, 1:] == packed[:, :-1]).mean() >= _EQUAL_SHARE
    if is_flat and colors <= _MOST_INSTANCES:
        low = min(int(red.max()), int(blue.max()))
        return "instances" if low <= _LAST_TAG else None
    if _is_depth(packed, low=red, high=blue) or _is_depth(packed, low=blue, high=red):
        return "depth"
    return "photo" if colors >= _FEWEST_COLORS else None


def _is_depth(
    packed: NDArray[np.int32], *, low: NDArray[np.uint8], high: NDArray[np.uint8]
) -> bool:
    """Whether these are the lowest and the highest byte of numbers of 24 bits.

    Only where neighbours differ, since the sky does not, are they looked at.
    """
    differ = packed[:, 1:] != packed[:, :-1]
    low_steps, high_steps = (
        # Bytes wrap around, so that 255 and 0 are neighbours.
        np.abs((byte[:, 1:] - byte[:, :-1])[differ].view(np.int8).astype(np.int16))
        for byte in (low, high)
    )
    is_smooth = (high_steps <= 1).mean() >= _SMOOTH_SHARE
    return bool(is_smooth and np.median(low_steps) >= _NOISE)


def _grey(rows: NDArray[np.uint8]) -> Look | None:
    if rows.shape[1] < 2:
        return None
    levels = np.unique(rows)
    if len(levels) < 2:
        return None
    is_flat = (rows[:, 1:] == rows[:, :-1]).mean() >= _EQUAL_SHARE
    are_tags = levels[-1] <= _LAST_LEVEL or np.gcd.reduce(levels) >= _LEAST_FACTOR
    if is_flat and are_tags and len(levels) <= _MOST_TAGS:
        return "segmentation"
    return "grey"
