"""Colour images decoded: faster where imagecodecs is installed.

Decoding is most of what a frame costs. imagecodecs (``unghost[fast]``) decodes PNGs by
libpng, as OpenCV does, but its wheels have one that uses vector instructions. Whatever
it does not take is OpenCV's to judge, so that the same files are accepted and refused,
in the same words, with and without it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from functools import cache
from typing import Final, Literal, TypeAlias, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.image_header import ImageHeader

ColorOrder: TypeAlias = Literal["rgb", "bgr"]
PngDecoder: TypeAlias = Callable[[bytes], NDArray[np.uint8]]

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
_INTERLACED_AT: Final = 28
"""Where a PNG says that its rows come in seven passes; its header comes first."""
_FIRST_CHUNK: Final = 8
_AROUND_BODY: Final = 12
"""A chunk's length, kind and checksum, four bytes each."""
_END: Final = b"\0\0\0\0IEND\xaeB`\x82"


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
    decoder = png_decoder()
    is_plain = header.bit_depth == 8 and header.color_model in ("rgb", "rgba")
    if decoder is None or header.media_type != "image/png" or not is_plain:
        return None
    if content[_INTERLACED_AT] or not _ends_with_its_pixels(content):
        return None
    try:
        pixels = decoder(content)
    except Exception:  # of many kinds; OpenCV says whether the file is of any use
        return None
    conversion = _CONVERSIONS.get((pixels.shape[-1], order))
    if conversion is None:
        return pixels
    return cast("NDArray[np.uint8]", cv2.cvtColor(pixels, conversion))


def _ends_with_its_pixels(content: bytes) -> bool:
    """Whether the first pixels are followed by sound ones and the end, and no more.

    imagecodecs stops at the last pixel; OpenCV reads on, and refuses what is wrong.
    """
    position, is_behind, view = _FIRST_CHUNK, False, memoryview(content)
    while position + _AROUND_BODY <= len(content):
        length, kind = struct.unpack_from(">I4s", content, position)
        following = position + _AROUND_BODY + length
        if kind == b"IDAT":
            is_behind = True
            # Of pixels beyond the last one, too, which imagecodecs does not look at.
            if view[following - 4 : following] != _checksum(view, position, length):
                return False
        elif is_behind:
            return content[position:following] == _END
        position = following
    return False


def _checksum(view: memoryview, position: int, length: int) -> bytes:
    return struct.pack(">I", zlib.crc32(view[position + 4 : position + 8 + length]))


@cache
def png_decoder() -> PngDecoder | None:
    """What decodes PNGs faster than OpenCV; None where it is not installed."""
    try:
        from imagecodecs import png_decode
    except ImportError:
        return None
    return cast("PngDecoder", png_decode)
