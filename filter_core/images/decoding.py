"""PNG and JPEG files decoded to pixels.

`decode_color` returns three colour channels, `decode_image` the form that OpenCV's
flags select. Both take the bytes and the header that `filter_core.images.header` read
from them, and return None for a damaged file.

Most of what decoding a segmentation costs is inflating it, and zlib-ng, which uses
vector instructions, takes a tenth of the time of the zlib inside OpenCV. So it inflates
plain PNGs: eight bits, three or four channels, not interlaced, every checksum right.
Rows of such a file that are stored as they are, or as differences of neighbours in the
row, are added up here. Where rows depend on those above them, as CARLA's
``save_to_disk`` writes them, OpenCV gets the same PNG with its pixels uncompressed.

Any other file goes to OpenCV as it is, once it is known that a PNG inflates to no more
than its header says. Apart from PNGs that inflate to more, the same files are accepted
and refused as by OpenCV alone, and their pixels are the same.

References
----------
.. [1] ISO/IEC 15948, "Portable Network Graphics (PNG)", clause 9, filtering.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, cast

import cv2
import numpy as np
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from filter_core.errors import ImageError
from filter_core.images.header import ImageHeader
from filter_core.images.pixels import ChannelOrder
from filter_core.images.png import (
    AROUND_BODY,
    END_CHUNK,
    SIGNATURE,
    pixel_parts,
    read_png,
)

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
    content: bytes, header: ImageHeader, order: ChannelOrder
) -> NDArray[np.uint8] | None:
    """(H, W, 3) uint8 in the given order of channels; None if it is damaged.

    Alpha is dropped; grey and indexed images become coloured ones. Raises `ImageError`:
    a PNG whose pixels inflate to more than its header says.
    """
    png = InflatedPng.of(content, header)
    if png is None:
        return decode_image(content, header, _FLAGS[order])
    pixels = png.added_up()
    if pixels is not None:
        conversion = _CONVERSIONS.get((pixels.shape[-1], order))
        if conversion is None:
            return pixels
        return np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)
    return _by_opencv(png.uncompressed(), header, _FLAGS[order])


def decode_image(
    content: bytes, header: ImageHeader, flags: int
) -> NDArray[np.uint8] | None:
    """(H, W) or (H, W, C) uint8: the image as decoded by OpenCV.

    It is uint16 if `flags` keep the depth. None if it is damaged, or if OpenCV finds
    another size than the header says.

    Parameters
    ----------
    content : bytes of a PNG or JPEG
    header : ImageHeader
        The result of `read_image_header` for the same bytes.
    flags : of `cv2.imdecode`
        With those that reduce the size to a half, a quarter or an eighth, the reduced
        size is expected. A rotation in EXIF is never applied.

    Raises
    ------
    ImageError
        A PNG whose pixels inflate to more than its header says.
    MemoryError
        There is not enough memory for its pixels: that is no fault of the file.
    """
    if header.media_type == "image/png":
        _refuse_surplus(content)
    upright = flags if flags < 0 else flags | cv2.IMREAD_IGNORE_ORIENTATION
    return _by_opencv(np.frombuffer(content, np.uint8), header, upright)


def decode_as_seen(
    content: bytes, header: ImageHeader, flags: int
) -> NDArray[np.uint8] | None:
    """The picture in the frame of reference of its boxes; for drawing, not measuring.

    Boxes and segmentations of a JPEG with an orientation in EXIF are made on the
    picture as every program shows it, so it is turned or mirrored, if that keeps its
    size. A quarter turn would exchange its sides: boxes and segmentation of such a
    frame, which has the size of the stored pixels, refer to those. Parameters, result
    and errors are those of `decode_image`.
    """
    if header.media_type == "image/jpeg":
        seen = _by_opencv(np.frombuffer(content, np.uint8), header, flags)
        if seen is not None:
            return seen
    return decode_image(content, header, flags)


_AT_ONCE: Final = 1 << 20
"""Bytes that are inflated in one step; they are only counted."""


def _refuse_surplus(content: bytes) -> None:
    """Inflate the pixels that the header of a PNG names, and refuse what follows them.

    OpenCV would inflate all of it, up to a thousand times the size of the file.
    """
    size = left = read_png(content, whole=False).inflated_bytes
    inflate = zlib_ng.decompressobj()
    for part in pixel_parts(content):
        rest: bytes | memoryview = part
        while len(rest) and not inflate.eof:
            try:
                left -= len(inflate.decompress(rest, min(left + 1, _AT_ONCE)))
            except _ERROR:
                return  # OpenCV stops there, too
            if left < 0:
                raise ImageError(
                    f"PNG: expected {size} bytes of pixels, as its header says, found "
                    "more when they were inflated"
                )
            rest = inflate.unconsumed_tail


def _by_opencv(
    content: NDArray[np.uint8], header: ImageHeader, flags: int
) -> NDArray[np.uint8] | None:
    try:
        pixels = cv2.imdecode(content, flags)
    except cv2.error as error:
        if error.code == cv2.Error.StsNoMem:
            raise MemoryError("decoding an image") from error
        return None
    if pixels is None or not _is_as_large(pixels.shape[:2], header, flags):
        return None
    return cast("NDArray[np.uint8]", pixels)


_REDUCED_2: Final = 16
"""`cv2.IMREAD_REDUCED_GRAYSCALE_2`; twice and four times it are a fourth, an eighth."""


def _is_as_large(hw: Sequence[int], header: ImageHeader, flags: int) -> bool:
    """A reduced side may be rounded up or down."""
    # -1 has every bit set, and reduces nothing.
    scale = 1 if flags < 0 else max(1, 2 * (flags // _REDUCED_2 % 8))
    sides = zip(hw, (header.height, header.width), strict=True)
    return all(
        max(1, side // scale) <= reduced <= -(-side // scale) for reduced, side in sides
    )


_MOST_BYTES: Final = 1 << 26
"""The largest image, in bytes, that is inflated here: that takes two or three copies of
it in memory, OpenCV alone takes one."""

_CHANNELS: Final = {"rgb": 3, "rgba": 4}

_METHODS: Final = slice(26, 29)
"""The position of compression, filters and interlacing in the header; usually 0."""

_SUB: Final = 1
"""The highest filter that does not depend on the row above; 0 is none."""

_BARE: Final = 33
"""Where the pixels begin if nothing but the header comes before them."""

_HEAD: Final = struct.Struct(">I4s")
"""The length and the kind of a chunk; then come its bytes, and their checksum."""

_IDAT: Final = b"IDAT"


@dataclass(frozen=True)
class InflatedPng:
    """A PNG of (H, W, C) pixels, inflated, but whose filters are not undone yet.

    `rows`, (H, 1 + W C) uint8, are each row's filter and its bytes; `head` is what it
    has before its pixels.
    """

    head: bytes
    rows: NDArray[np.uint8]
    shape: tuple[int, int, int]

    @classmethod
    def of(cls, content: bytes, header: ImageHeader) -> InflatedPng | None:
        """None if it is of another kind or damaged: OpenCV has to judge it."""
        channels = _CHANNELS.get(header.color_model, 0)
        shape = header.height, header.width, channels
        size = header.height * (1 + header.width * channels)
        is_plain = header.media_type == "image/png" and header.bit_depth == 8
        if not (channels and is_plain) or any(content[_METHODS]) or size > _MOST_BYTES:
            return None
        parts = _Parts.of(content)
        if parts is None:
            return None
        data = _inflated(parts.body, size)
        if data is None:
            return None
        rows = np.frombuffer(data, np.uint8).reshape(header.height, -1)
        return cls(parts.head, rows, shape)

    def added_up(self) -> NDArray[np.uint8] | None:
        """(H, W, C) uint8; None if a row depends on the one above it.

        None as well if other chunks stand before its pixels: OpenCV judges what they
        mean.
        """
        filters, stored = self.rows[:, 0], self.rows[:, 1:].reshape(self.shape)
        if len(self.head) != _BARE or int(filters.max()) > _SUB:
            return None
        is_sub = filters == _SUB
        if is_sub.all():
            return np.add.accumulate(stored, axis=1, dtype=np.uint8)
        pixels = np.ascontiguousarray(stored)
        if is_sub.any():
            pixels[is_sub] = np.add.accumulate(stored[is_sub], axis=1, dtype=np.uint8)
        return pixels

    def uncompressed(self) -> NDArray[np.uint8]:
        """The same PNG as bytes, whose rows are stored without being compressed."""
        body = zlib_ng.compress(self.rows.data, 0)
        chunk = _HEAD.pack(len(body), _IDAT), body, _sum_of(_IDAT, body)
        return np.frombuffer(b"".join((self.head, *chunk, END_CHUNK)), np.uint8)


_ERROR: Final = cast("type[Exception]", zlib_ng.error)


def _inflated(body: bytes, size: int) -> bytes | None:
    """So many bytes, whose checksum is right; None if there are more or fewer."""
    inflate = zlib_ng.decompressobj()
    try:
        # A buffer of one more byte makes it read to the end, and check the checksum.
        data: bytes = inflate.decompress(body, size + 1)
    except _ERROR:
        return None
    return data if inflate.eof and len(data) == size else None


@dataclass(frozen=True)
class _Parts:
    """A PNG with correct checksums, in which only the end follows the pixels.

    OpenCV also reads what follows the pixels, and refuses faults there; so any other
    PNG is left to OpenCV as a whole.
    """

    head: bytes
    body: bytes

    @classmethod
    def of(cls, content: bytes) -> _Parts | None:
        """None for any other PNG."""
        position, begin, bodies = len(SIGNATURE), 0, list[memoryview]()
        view = memoryview(content)
        while position + AROUND_BODY <= len(content):
            length, kind = _HEAD.unpack_from(content, position)
            following = position + AROUND_BODY + length
            chunk = view[position:following]
            is_looked_at = kind == _IDAT or position == len(SIGNATURE)
            if is_looked_at and _sum_of(kind, chunk[8:-4]) != chunk[-4:]:
                return None
            if kind == _IDAT:
                begin = begin or position
                bodies.append(chunk[8:-4])
            elif bodies:
                is_end = bytes(chunk) == END_CHUNK
                return cls(content[:begin], b"".join(bodies)) if is_end else None
            position = following
        return None


def _sum_of(kind: bytes, body: bytes | memoryview) -> bytes:
    """The checksum of a chunk, over its kind and its bytes."""
    return struct.pack(">I", zlib_ng.crc32(body, zlib_ng.crc32(kind)))
