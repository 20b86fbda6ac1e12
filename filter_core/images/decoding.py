"""PNGs of eight bits and three or four channels, inflated by zlib-ng.

Most of what decoding a mask costs is inflating it, and zlib-ng, with vector
instructions, takes a tenth of zlib's time for it. What is left then are rows that were
filtered (ISO/IEC 15948, 9). OpenCV writes differences of neighbours in a row, which one
pass adds up. Rows that depend on those above, as CARLA's ``save_to_disk`` writes them,
are left to OpenCV, in a PNG that is not compressed.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from filter_core.images.header import ImageHeader

Bytes: TypeAlias = NDArray[np.uint8]

_MOST_BYTES: Final = 1 << 26
"""Bytes of pixels that are held twice or thrice on the way; OpenCV alone holds them
once."""

_CHANNELS: Final = {"rgb": 3, "rgba": 4}

_METHODS: Final = slice(26, 29)
"""Where the header names compression, filters and interlacing; 0 is the common one."""

_NO_FILTER, _SUB = 0, 1

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

_ERROR: Final = cast("type[Exception]", zlib_ng.error)


@dataclass(frozen=True)
class InflatedPng:
    """What a PNG has before its pixels, and its rows: each a filter and its bytes."""

    head: bytes
    rows: Bytes
    shape: tuple[int, int, int]

    @classmethod
    def of(cls, content: bytes, header: ImageHeader) -> InflatedPng | None:
        """None if somebody else has to judge it: it is of another kind, or damaged."""
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

    def added_up(self) -> Bytes | None:
        """(H, W, C) uint8, if all rows are as they are or differences in themselves."""
        filters, stored = self.rows[:, 0], self.rows[:, 1:].reshape(self.shape)
        if len(self.head) != _BARE or int(filters.max()) > _SUB:
            return None
        pixels = np.add.accumulate(stored, axis=1, dtype=np.uint8)
        if not filters.all():
            pixels[filters == _NO_FILTER] = stored[filters == _NO_FILTER]
        return pixels

    def uncompressed(self) -> Bytes:
        """A PNG whose pixels are in blocks that are stored as they are."""
        data = self.rows.reshape(-1)
        blocks, last = divmod(data.size - 1, _BLOCK)
        cut, last = blocks * _BLOCK, last + 1
        before = self.head + bytes(4) + b"IDAT" + _ZLIB
        at = len(before) + cut + _BLOCK_HEAD.size * blocks
        behind = at + _BLOCK_HEAD.size + last
        png = np.empty(behind + _SUM.size * 2 + len(_END), np.uint8)

        png.data[: len(before)] = before
        stored = png[len(before) : at].reshape(blocks, _BLOCK_HEAD.size + _BLOCK)
        stored[:, : _BLOCK_HEAD.size] = np.frombuffer(_block_head(_BLOCK), np.uint8)
        stored[:, _BLOCK_HEAD.size :] = data[:cut].reshape(blocks, _BLOCK)
        png.data[at : at + _BLOCK_HEAD.size] = _block_head(last, is_last=True)
        png[behind - last : behind] = data[cut:]
        _SUM.pack_into(png.data, behind, zlib_ng.adler32(data.data))

        chunk = png.data[len(self.head) : behind + 2 * _SUM.size]
        _SUM.pack_into(chunk, 0, len(chunk) - _AROUND_BODY)
        _SUM.pack_into(chunk, len(chunk) - _SUM.size, zlib_ng.crc32(chunk[4:-4]))
        png.data[-len(_END) :] = _END
        return png


def _inflated(body: bytes, size: int) -> bytes | None:
    """So many bytes, whose checksum is right; None if there are more or fewer."""
    inflate = zlib_ng.decompressobj()
    try:
        # With room for one more, it reads on to the end and to the checksum.
        data: bytes = inflate.decompress(body, size + 1)
    except _ERROR:
        return None
    return data if inflate.eof and len(data) == size else None


def _block_head(size: int, *, is_last: bool = False) -> bytes:
    return _BLOCK_HEAD.pack(is_last, size, size ^ _BLOCK)


@dataclass(frozen=True)
class _Parts:
    """A PNG whose pixels are sound, and which ends with them.

    OpenCV reads on behind the last pixel, and refuses what is wrong there: any doubt
    leaves it the whole file.
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
            if is_looked_at and not _is_sound(chunk):
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
    return _SUM.pack(zlib_ng.crc32(chunk[4:-4])) == chunk[-4:]
