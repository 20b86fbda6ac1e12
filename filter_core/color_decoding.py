"""Colour images decoded: the pixels that OpenCV finds, mostly in a third of its time.

Whatever is not plain and sound is OpenCV's to judge, so that the same files are
accepted and refused as by OpenCV alone.
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.image_header import ImageHeader
from filter_core.png_decoding import InflatedPng

ColorOrder: TypeAlias = Literal["rgb", "bgr"]

# Alpha says nothing about a tag, and a rotation in EXIF is not the camera's.
_FLAGS: Final = {
    "rgb": cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION,
    "bgr": cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION,
}
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
    found = decode_by_opencv(plain, order)
    if found is None or found.shape[:2] != (header.height, header.width):
        return None
    return found


def decode_by_opencv(
    content: NDArray[np.uint8], order: ColorOrder
) -> NDArray[np.uint8] | None:
    """(H, W, 3) uint8; None if OpenCV refuses the file."""
    try:
        found = cv2.imdecode(content, _FLAGS[order])
    except cv2.error:
        return None
    return cast("NDArray[np.uint8] | None", found)


def _in_order(pixels: NDArray[np.uint8], order: ColorOrder) -> NDArray[np.uint8]:
    conversion = _CONVERSIONS.get((pixels.shape[-1], order))
    if conversion is None:
        return pixels
    return cast("NDArray[np.uint8]", cv2.cvtColor(pixels, conversion))
