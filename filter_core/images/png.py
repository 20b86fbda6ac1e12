"""The chunks of a PNG, walked from its signature to its end; nothing is decoded.

A file is refused if two programs could find different images in it, or if it costs more
to read than its pixels do. What follows its end is no part of it: no decoder reads it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from mmap import mmap
from typing import Final, NamedTuple

from filter_core.errors import ImageError

SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"

_MAX_ANCILLARY: Final = 500
"""Chunks besides the picture itself; programs write one per note, some dozens."""

_MAX_ANCILLARY_BYTES: Final = 1 << 24

_MAX_COMPRESSED: Final = 16
"""Chunks besides the picture whose content is compressed."""

_MAX_INFLATED_BYTES: Final = 1 << 22
"""Of all these together; a profile of colours has some 500 KB."""

_FEW_PARTS: Final = 1024
"""Number of parts that are always allowed, of any size."""

_PART_BYTES: Final = 1024
"""Pixels come in parts of 8 KiB or more; many parts that are smaller are refused."""

_TAIL: Final = 4096
"""Where the end usually is, counted from the end of the file."""

AROUND_BODY: Final = 12
"""A chunk's length, kind and checksum, four bytes each."""

_HEAD: Final = struct.Struct(">I4s")

END_CHUNK: Final = b"\0\0\0\0IEND\xaeB`\x82"

_END_MARK: Final = END_CHUNK[4:]

_CRITICAL: Final = (b"IHDR", b"PLTE", b"IDAT", b"IEND")

_ANIMATED: Final = (b"acTL", b"fcTL", b"fdAT")

_COMPRESSED: Final = (b"zTXt", b"iTXt", b"iCCP")

_INDEXED: Final = 3
_SAMPLES: Final = {0: 1, 2: 3, _INDEXED: 1, 4: 2, 6: 4}
"""Numbers of a pixel, by colour type."""
_ONE_PASS: Final = ((0, 0, 1, 1),)
_ADAM7: Final = (
    *((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4)),
    *((0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)),
)
"""First column and row of each pass, and the steps to the next (W3C, PNG, 8.2)."""
_ROOM_BYTES: Final = 1 << 16
"""What compressed pixels may have besides twice their size: blocks that are empty."""

_BIT_DEPTHS: Final = {
    0: (1, 2, 4, 8, 16),
    2: (8, 16),
    _INDEXED: (1, 2, 4, 8),
    4: (8, 16),
    6: (8, 16),
}


@dataclass(frozen=True)
class PngHeader:
    """What the first chunk says.

    The size, px, the bits of one sample, and the colour type: 0, 2, 3, 4 or 6.
    """

    width: int
    height: int
    bit_depth: int
    color_type: int
    is_interlaced: bool = False

    @property
    def inflated_bytes(self) -> int:
        """Of all rows, each with a byte for its filter (W3C, PNG, 7.2 and 8.1)."""
        bits = self.bit_depth * _SAMPLES[self.color_type]
        passes = _ADAM7 if self.is_interlaced else _ONE_PASS
        return sum(
            rows * (1 + (columns * bits + 7) // 8)
            for left, top, across, down in passes
            if (columns := -(-(self.width - left) // across)) > 0
            and (rows := -(-(self.height - top) // down)) > 0
        )


def read_png(content: bytes | mmap, *, whole: bool) -> PngHeader:
    """The header of a PNG whose chunks are in order.

    Parameters
    ----------
    content : bytes, or a mapped file
    whole : bool
        False: what comes behind the first pixels is not looked at, if the end is near
        that of the file.

    Raises
    ------
    ImageError
        It ends too early, is animated, has chunks that are critical and not known, come
        too often, too late or in between, or more besides its pixels than any program
        writes.
    """
    walk = _Walk(content)
    # If much follows the end, or there is none, only the chunks tell which.
    whole = whole or _END_MARK not in content[-_TAIL:]
    for chunk in walk.chunks(parts_as_one=whole):
        walk.check(chunk)
        if chunk.kind == b"IEND" or (chunk.kind == b"IDAT" and not whole):
            break
    return walk.finished()


def pixel_parts(content: bytes) -> Iterator[memoryview]:
    """The compressed pixels of a PNG that `read_png` has found in order, as stored."""
    view, position = memoryview(content), len(SIGNATURE)
    while position + AROUND_BODY <= len(content):
        length, kind = _HEAD.unpack_from(content, position)
        if kind == b"IDAT":
            yield view[position + 8 : position + 8 + length]
        if kind == b"IEND":
            return  # chunks that follow the end are not of this image
        position += AROUND_BODY + length


class _Chunk(NamedTuple):
    """A chunk, or as one all the parts of the pixels that follow one another."""

    kind: bytes
    start: int
    length: int
    parts: int = 1


@dataclass
class _Walk:
    """What has been found in the chunks so far, and the limits on it."""

    content: bytes | mmap
    header: PngHeader | None = None
    kinds: set[bytes] = field(default_factory=set)
    last: bytes = b""
    parts: int = 0
    part_bytes: int = 0
    ancillary: int = 0
    ancillary_bytes: int = 0
    compressed: int = 0
    inflated_bytes: int = 0

    def chunks(self, *, parts_as_one: bool) -> Iterator[_Chunk]:
        """One after the other, each wholly within the file."""
        content = self.content
        position, size = len(SIGNATURE), len(content)
        start, length, parts, total = position, 0, 0, 0
        while position + AROUND_BODY <= size:
            length, kind = _HEAD.unpack_from(content, position)
            if position + AROUND_BODY + length > size:
                break
            # A photograph has hundreds of parts: one step for all of them.
            if parts_as_one and kind == b"IDAT" and parts <= _max_parts(total):
                start = start if parts else position
                parts, total = parts + 1, total + length
            else:
                if parts:
                    yield _Chunk(b"IDAT", start, total, parts)
                    parts = total = 0
                yield _Chunk(kind, position, length)
            position += AROUND_BODY + length
        if parts:
            yield _Chunk(b"IDAT", start, total, parts)
        raise ImageError(f"PNG: the file ends too early, after {len(content)} bytes")

    def check(self, chunk: _Chunk) -> None:
        """Raise `ImageError` if the chunk may not stand here; else count it."""
        kind = chunk.kind
        if self.header is None:
            self.header = self._read_header(chunk)
        elif kind == b"IDAT":
            if b"IDAT" in self.kinds and self.last != b"IDAT":
                raise ImageError(
                    f"PNG: {_named(self.last)} is between the chunks of pixels"
                )
            self.parts += chunk.parts
            self.part_bytes += chunk.length
            if self.parts > _max_parts(self.part_bytes):
                raise ImageError(
                    f"PNG: {self.parts} parts with {self.part_bytes} bytes of pixels; "
                    f"expected parts of {_PART_BYTES} bytes or more"
                )
        elif kind in _CRITICAL:
            self._take_critical(chunk)
        else:
            self._take_ancillary(chunk)
        self.kinds.add(kind)
        self.last = kind

    def finished(self) -> PngHeader:
        """The header, if there were pixels, and a palette where they need one."""
        if b"IDAT" not in self.kinds or self.header is None:
            raise ImageError("PNG: found no pixels")
        if self.header.color_type == _INDEXED and b"PLTE" not in self.kinds:
            raise ImageError("PNG: expected a palette before the indexes, found none")
        size = self.header.inflated_bytes
        if self.part_bytes > 2 * size + _ROOM_BYTES:
            raise ImageError(
                f"PNG: {self.part_bytes} bytes for pixels that take {size} bytes when "
                "they are not compressed"
            )
        return self.header

    def _read_header(self, chunk: _Chunk) -> PngHeader:
        if chunk.kind != b"IHDR" or chunk.length != 13:
            raise ImageError("PNG: expected a header of 13 bytes first")
        self._require_checksum(chunk)
        width, height, bit_depth, color_type, *methods = struct.unpack(
            ">IIBBBBB", self._body(chunk)
        )
        if bit_depth not in _BIT_DEPTHS.get(color_type, ()):
            raise ImageError(
                f"PNG: unknown colour type {color_type} with bit depth {bit_depth}"
            )
        compression, filters, interlacing = methods
        if compression or filters or interlacing > 1:
            raise ImageError(
                "PNG: expected methods 0, 0 and 0 or 1 for compression, filters and "
                f"interlacing, found {compression}, {filters} and {interlacing}"
            )
        return PngHeader(width, height, bit_depth, color_type, bool(interlacing))

    def _take_critical(self, chunk: _Chunk) -> None:
        if chunk.kind in self.kinds:
            raise ImageError(f"PNG: expected one {_named(chunk.kind)}, found another")
        self._require_checksum(chunk)
        if chunk.kind == b"IEND":
            if chunk.length:
                raise ImageError(
                    f"PNG: the end has {chunk.length} bytes, expected none"
                )
        elif b"IDAT" in self.kinds:
            raise ImageError("PNG: expected the palette before the pixels")
        elif chunk.length % 3 or not 0 < chunk.length <= 768:
            raise ImageError(
                f"PNG: expected a palette of 1 to 256 colours, found {chunk.length} "
                "bytes"
            )

    def _take_ancillary(self, chunk: _Chunk) -> None:
        kind = chunk.kind
        if kind in _ANIMATED:
            raise ImageError("expected one image, found an animated PNG")
        # The fifth bit of the first letter tells what may be passed over.
        if not (kind.isalpha() and kind[:1].islower()):
            raise ImageError(
                f"PNG: found {_named(kind)}, an unknown chunk that must not be ignored"
            )
        self.ancillary += 1
        self.ancillary_bytes += chunk.length
        if self.ancillary > _MAX_ANCILLARY:
            raise ImageError(
                f"PNG: more than {_MAX_ANCILLARY} chunks besides its pixels"
            )
        if self.ancillary_bytes > _MAX_ANCILLARY_BYTES:
            raise ImageError(
                f"PNG: {self.ancillary_bytes} bytes besides its pixels, expected at "
                f"most {_MAX_ANCILLARY_BYTES}"
            )
        if kind in _COMPRESSED:
            self.compressed += 1
            if self.compressed > _MAX_COMPRESSED:
                raise ImageError(
                    f"PNG: more than {_MAX_COMPRESSED} compressed texts and profiles"
                )
            left = _MAX_INFLATED_BYTES - self.inflated_bytes
            self.inflated_bytes += _inflated_size(chunk.kind, self._body(chunk), left)
            if self.inflated_bytes > _MAX_INFLATED_BYTES:
                raise ImageError(
                    "PNG: its texts and profiles inflate to more than "
                    f"{_MAX_INFLATED_BYTES} bytes"
                )

    def _require_checksum(self, chunk: _Chunk) -> None:
        start, end = chunk.start + 4, chunk.start + 8 + chunk.length
        checksum = zlib.crc32(self.content[start:end])
        if self.content[end : end + 4] != struct.pack(">I", checksum):
            raise ImageError(f"PNG: the checksum of its {_named(chunk.kind)} is wrong")

    def _body(self, chunk: _Chunk) -> bytes:
        return self.content[chunk.start + 8 : chunk.start + 8 + chunk.length]


def _max_parts(size: int) -> int:
    """How many parts pixels of so many bytes may come in."""
    return _FEW_PARTS + size // _PART_BYTES


def _inflated_size(kind: bytes, body: bytes, most: int) -> int:
    """Bytes that a text or profile inflates to, counted to one above `most`."""
    _, _, behind = body.partition(b"\0")
    if kind == b"iTXt":
        if behind[:1] != b"\1":
            return 0
        # A flag, a method, a language and a translation, each of these two ended by 0.
        _, _, behind = behind[2:].partition(b"\0")
        _, _, behind = behind.partition(b"\0")
    else:
        behind = behind[1:]
    inflate = zlib.decompressobj()
    try:
        return len(inflate.decompress(behind, most + 1))
    except zlib.error:
        return 0  # decoders pass over what they cannot inflate


def _named(kind: bytes) -> str:
    words = {b"IHDR": "header", b"PLTE": "palette", b"IEND": "end"}
    return words.get(kind, f"chunk {kind!r}")
