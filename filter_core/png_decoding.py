"""PNGs of eight bits and three or four channels, decoded by imagecodecs if it is there.

Most of what decoding a mask costs is zlib's. imagecodecs (``unghost[fast]``) brings
libdeflate, which inflates one in a tenth of the time. What is left then are rows that
were filtered (ISO/IEC 15948, 9). OpenCV writes differences of neighbours in a row,
which one pass adds up. Rows that depend on those above, as CARLA's ``save_to_disk``
writes them, are given to libpng, in a PNG that is not compressed: it undoes the filters
with vector instructions.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Sized
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.image_header import ImageHeader

Bytes: TypeAlias = NDArray[np.uint8]

_CHANNELS: Final = {"rgb": 3, "rgba": 4}
_METHODS: Final = slice(26, 29)
"""Where the header names compression, filters and interlacing; 0 is the common one."""
_NO_FILTER, _SUB = 0, 1
_ANIMATION: Final = (b"acTL", b"fcTL")
"""OpenCV knows what these mean, and refuses what they may not say."""
_FIRST_CHUNK: Final = 8
_BARE: Final = 33
"""Where the pixels begin if nothing but the header comes before them."""
_AROUND_BODY: Final = 12
"""A chunk's length, kind and checksum, four bytes each."""
_END: Final = b"\0\0\0\0IEND\xaeB`\x82"
_ZLIB: Final = b"\x78\x01"
_BLOCK: Final = 0xFFFF
"""Bytes of the longest block that is stored as it is (RFC 1951, 3.2.4)."""
_BLOCK_HEAD: Final = struct.Struct("<BHH")
_SUM: Final = struct.Struct(">I")


_MOST_BYTES: Final = 1 << 26
"""Bytes of pixels, of which the steps hold three times as many, libpng one."""


class Inflate(Protocol):
    """Undo zlib's compression into an array; the part of it that was filled."""

    def __call__(self, data: bytes, /, *, out: memoryview) -> Sized: ...


class AddUp(Protocol):
    """Sums along an axis, modulo 256."""

    def __call__(self, data: Bytes, /, *, axis: int) -> NDArray[Any]: ...


class PngCodecs(NamedTuple):
    """What imagecodecs does for a PNG: all of it, or one of its steps."""

    decode: Callable[..., NDArray[Any]]
    inflate: Inflate
    add_up: AddUp
    crc32: Callable[..., int]
    adler32: Callable[..., int]


@cache
def png_codecs() -> PngCodecs | None:
    """What decodes PNGs faster than OpenCV; None where it is not installed."""
    try:
        import imagecodecs as found
    except ImportError:
        return None
    return PngCodecs(
        decode=found.png_decode,
        inflate=found.deflate_decode,
        add_up=found.delta_decode,
        crc32=found.deflate_crc32,
        adler32=found.deflate_adler32,
    )


def decode_png(content: bytes, header: ImageHeader) -> Bytes | None:
    """(H, W, 3 or 4) uint8, red first; None if somebody else has to judge the file.

    That is where imagecodecs is missing, the PNG is of another kind, or it is damaged.
    """
    codecs, channels = png_codecs(), _CHANNELS.get(header.color_model)
    is_plain = header.media_type == "image/png" and header.bit_depth == 8
    if codecs is None or channels is None or not is_plain or any(content[_METHODS]):
        return None
    parts = _Parts.of(content)
    if parts is None:
        return None
    shape = header.height, header.width, channels
    # Errors are of many kinds: of damaged files, and of builds that lack a library.
    if math.prod(shape) <= _MOST_BYTES:
        with suppress(Exception):
            return _in_steps(codecs, parts, shape)
    with suppress(Exception):
        return codecs.decode(content)
    return None


def _in_steps(
    codecs: PngCodecs, parts: _Parts, shape: tuple[int, int, int]
) -> Bytes | None:
    height, width, channels = shape
    rows = np.empty((height, 1 + width * channels), np.uint8)
    if len(codecs.inflate(parts.body, out=rows.reshape(-1).data)) != rows.size:
        return None
    filters, stored = rows[:, 0], rows[:, 1:].reshape(shape)
    if len(parts.head) != _BARE or int(filters.max()) > _SUB:
        return codecs.decode(_uncompressed(codecs, parts.head, rows))
    pixels = codecs.add_up(stored, axis=1)
    if not filters.all():
        pixels[filters == _NO_FILTER] = stored[filters == _NO_FILTER]
    return pixels


def _uncompressed(codecs: PngCodecs, head: bytes, rows: Bytes) -> memoryview:
    """A PNG whose pixels are in blocks that are stored as they are."""
    data = rows.reshape(-1)
    blocks, last = divmod(data.size - 1, _BLOCK)
    cut, last = blocks * _BLOCK, last + 1
    before = head + bytes(4) + b"IDAT" + _ZLIB
    behind = len(before) + cut + _BLOCK_HEAD.size * (blocks + 1) + last
    png = np.empty(behind + _SUM.size * 2 + len(_END), np.uint8)

    png[: len(before)] = np.frombuffer(before, np.uint8)
    at = behind - last - _BLOCK_HEAD.size
    stored = png[len(before) : at].reshape(blocks, _BLOCK_HEAD.size + _BLOCK)
    stored[:, : _BLOCK_HEAD.size] = np.frombuffer(_block_head(_BLOCK), np.uint8)
    stored[:, _BLOCK_HEAD.size :] = data[:cut].reshape(blocks, _BLOCK)
    png.data[at : at + _BLOCK_HEAD.size] = _block_head(last, is_last=True)
    png[behind - last : behind] = data[cut:]
    _SUM.pack_into(png.data, behind, codecs.adler32(data.data))

    chunk = png.data[len(head) : behind + 2 * _SUM.size]
    _SUM.pack_into(chunk, 0, len(chunk) - _AROUND_BODY)
    _SUM.pack_into(chunk, len(chunk) - _SUM.size, codecs.crc32(chunk[4:-4]))
    png.data[-len(_END) :] = _END
    return png.data


def _block_head(size: int, *, is_last: bool = False) -> bytes:
    return _BLOCK_HEAD.pack(is_last, size, size ^ _BLOCK)


@dataclass(frozen=True)
class _Parts:
    """A PNG whose pixels are sound, and which ends with them.

    imagecodecs stops at the last pixel; OpenCV reads on, and refuses what is wrong. So
    do checksums of pixels beyond the last one count, which nothing else looks at.
    """

    head: bytes
    body: bytes

    @classmethod
    def of(cls, content: bytes) -> _Parts | None:
        """None if there is any doubt."""
        position, begin, bodies = _FIRST_CHUNK, 0, list[memoryview]()
        view = memoryview(content)
        while position + _AROUND_BODY <= len(content):
            length, kind = struct.unpack_from(">I4s", content, position)
            following = position + _AROUND_BODY + length
            chunk = view[position:following]
            is_looked_at = kind == b"IDAT" or position == _FIRST_CHUNK
            if kind in _ANIMATION or (is_looked_at and not _is_sound(chunk)):
                return None
            if kind == b"IDAT":
                begin = begin or position
                bodies.append(chunk[8:-4])
            elif bodies:
                is_end = bytes(chunk) == _END
                return cls(content[:begin], b"".join(bodies)) if is_end else None
            position = following
        return None


def _is_sound(chunk: memoryview) -> bool:
    return struct.pack(">I", zlib.crc32(chunk[4:-4])) == chunk[-4:]
