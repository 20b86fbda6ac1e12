"""Colour images decoded: faster where imagecodecs is installed.

Decoding is most of what a frame costs (`filter_core/png_decoding.py`). Whatever
imagecodecs does not take is OpenCV's to judge, so that the same files are accepted and
refused, in the same words, with and without it.
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.image_header import ImageHeader
from filter_core.png_decoding import decode_png

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
    pixels = _decoded_fast(content, header, order)
    if pixels is None:
        pixels = _decoded(content, order)
    if pixels is None or pixels.shape[:2] != (header.height, header.width):
        return None
    return pixels


def _decoded(content: bytes, order: ColorOrder) -> NDArray[np.uint8] | None:
    try:
        found = cv2.imdecode(np.frombuffer(content, np.uint8), _FLAGS[order])
    except cv2.error:
        return None
    return cast("NDArray[np.uint8] | None", found)


def _decoded_fast(
    content: bytes, header: ImageHeader, order: ColorOrder
) -> NDArray[np.uint8] | None:
    pixels = decode_png(content, header)
    if pixels is None:
        return None
    conversion = _CONVERSIONS.get((pixels.shape[-1], order))
    if conversion is None:
        return pixels
    return cast("NDArray[np.uint8]", cv2.cvtColor(pixels, conversion))
