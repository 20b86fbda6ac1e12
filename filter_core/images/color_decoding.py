"""Colour images decoded: the pixels that OpenCV finds, mostly in a third of its time.

Whatever is not plain and sound is OpenCV's to judge, so that the same files are
accepted and refused as by OpenCV alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal, TypeAlias, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.images.decoding import InflatedPng
from filter_core.images.header import ImageHeader

ColorOrder: TypeAlias = Literal["rgb", "bgr"]

# Alpha says nothing about a tag, and a rotation in EXIF is not the camera's.
_FLAGS: Final = {
    "rgb": cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION,
    "bgr": cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION,
}

_REDUCED_2: Final = 16
"""`cv2.IMREAD_REDUCED_GRAYSCALE_2`; twice and four times it are a fourth, an eighth."""

_CONVERSIONS: Final = {
    (3, "bgr"): cv2.COLOR_RGB2BGR,
    (4, "rgb"): cv2.COLOR_RGBA2RGB,
    (4, "bgr"): cv2.COLOR_RGBA2BGR,
}


def decode_color(
    content: bytes, header: ImageHeader, order: ColorOrder
) -> NDArray[np.uint8] | None:
    """(H, W, 3) uint8 in the given order of channels; None if it is damaged.

    Alpha is dropped; grey and indexed images become coloured ones.
    """
    png = InflatedPng.of(content, header)
    pixels = None if png is None else png.added_up()
    if pixels is not None:
        return _in_order(pixels, order)
    plain = np.frombuffer(content, np.uint8) if png is None else png.uncompressed()
    return _by_opencv(plain, header, _FLAGS[order])


def decode_image(
    content: bytes, header: ImageHeader, flags: int
) -> NDArray[np.uint8] | None:
    """What OpenCV decodes of a file, if it is as large as the header says.

    Parameters
    ----------
    content : bytes of a PNG or JPEG
    header : ImageHeader
        What `read_image_header` says of the same bytes.
    flags : of `cv2.imdecode`
        With those that reduce the size to a half, a quarter or an eighth, the reduced
        size is expected. A rotation in EXIF is never applied.

    Returns
    -------
    (H, W) or (H, W, C) uint8, or uint16 if `flags` keep the depth
        None if it is damaged, or if OpenCV finds another size.

    Raises
    ------
    MemoryError
        There is not enough memory for its pixels: that is no fault of the file.
    """
    upright = flags if flags < 0 else flags | cv2.IMREAD_IGNORE_ORIENTATION
    return _by_opencv(np.frombuffer(content, np.uint8), header, upright)


def _by_opencv(
    content: NDArray[np.uint8], header: ImageHeader, flags: int
) -> NDArray[np.uint8] | None:
    try:
        found = cv2.imdecode(content, flags)
    except cv2.error as error:
        if error.code == cv2.Error.StsNoMem:
            raise MemoryError("decoding an image") from error
        return None
    if found is None or not _is_as_large(found.shape[:2], header, flags):
        return None
    return cast("NDArray[np.uint8]", found)


def _is_as_large(hw: Sequence[int], header: ImageHeader, flags: int) -> bool:
    """A reduced side may be rounded up or down."""
    # -1 has every bit set, and reduces nothing.
    scale = 1 if flags < 0 else max(1, 2 * (flags // _REDUCED_2 % 8))
    sides = zip(hw, (header.height, header.width), strict=True)
    return all(
        max(1, side // scale) <= found <= -(-side // scale) for found, side in sides
    )


def _in_order(pixels: NDArray[np.uint8], order: ColorOrder) -> NDArray[np.uint8]:
    conversion = _CONVERSIONS.get((pixels.shape[-1], order))
    if conversion is None:
        return pixels
    return cast("NDArray[np.uint8]", cv2.cvtColor(pixels, conversion))
