"""The segments and scans of a JPEG, walked from its first byte to its end.

Nothing is decoded. This reader finds the same segments as any decoder. libjpeg skips
bytes that are no marker, so a file could have one size for a reader that follows the
lengths of its segments, and another size for a decoder. Such files are refused.

References
----------
.. [1] ITU-T T.81, annex B.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from mmap import mmap
from typing import Final

from filter_core.errors import ImageError

_MAX_SCANS: Final = 32
"""Of a progressive picture; encoders write 10, and 18 for four channels. A decoder goes
through all blocks in each."""

_MAX_SEGMENTS: Final = 1000

_WINDOW: Final = 1 << 20
"""Bytes that are searched at a time; Python lets others run in between."""

_MAX_PADDING: Final = 64

_SOI, _EOI, _SOS = 0xD8, 0xD9, 0xDA

_TABLES: Final = frozenset({0xC4, 0xDB, 0xDD})  # DHT, DQT, DRI

_NOTES: Final = frozenset({*range(0xE0, 0xF0), 0xFE})  # APP0 to APP15, COM

_BASELINE, _EXTENDED, _PROGRESSIVE = 0xC0, 0xC1, 0xC2

_FRAMES: Final = frozenset({_BASELINE, _EXTENDED, _PROGRESSIVE})

_OTHER_FRAMES: Final = {
    **dict.fromkeys((0xC3, 0xC7, 0xCB, 0xCF), "a lossless image"),
    **dict.fromkeys((0xC5, 0xC6, 0xCD, 0xCE, 0xDE, 0xDF), "a hierarchical image"),
    **dict.fromkeys((0xC9, 0xCA, 0xCC), "arithmetic coding"),
    0xDC: "a height that follows the pixels",
    _SOI: "an image within the image",
}

# Behind 0xFF: 0 is data, 0xD0 to 0xD7 are pauses, and 0xFF is padding.
_MARKER_IN_SCAN: Final = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")


def read_jpeg(content: bytes | mmap, *, whole: bool) -> tuple[int, int, int]:
    """Width, height, px, and channels of a JPEG whose segments are in order.

    There are 1, 3 or 4 channels of 8 bits each.

    Parameters
    ----------
    content : bytes, or a mapped file
        What follows its end does not count: cameras put more pictures there.
    whole : bool
        False: what comes behind the first scan's header is not looked at.

    Raises
    ------
    ImageError
        It ends too early, has bytes that are no marker between its segments, more than
        one picture, more scans or segments than any program writes, or is coded in a
        way that is not common.
    """
    walk = _Walk(content)
    position = 2
    for _ in range(_MAX_SEGMENTS + _MAX_SCANS):
        # The marker that has to be here, and where it ends
        head = content[position : position + _MAX_PADDING]
        bare = head.lstrip(b"\xff")
        padding = len(head) - len(bare)
        if not bare:
            if position + padding >= len(content):
                raise _ends_too_early(content)
            raise ImageError(f"JPEG: more than {_MAX_PADDING} bytes of padding")
        if not padding:
            raise ImageError(
                f"JPEG: expected a marker at byte {position}, found {bytes(head[:4])!r}"
            )
        marker, position = bare[0], position + padding + 1
        if marker == _EOI:
            return walk.finished()
        position = walk.passed(marker, position)
        if marker == _SOS:
            if not whole:
                return walk.finished()
            position = _end_of_scan(content, position)
    raise ImageError(f"JPEG: more than {_MAX_SEGMENTS} segments")


@dataclass
class _Walk:
    """What has been found in the segments so far."""

    content: bytes | mmap
    header: tuple[int, int, int] | None = None
    scans: int = 0
    max_scans: int = 0

    def passed(self, marker: int, position: int) -> int:
        """Where the segment ends whose marker ends here."""
        if marker not in _FRAMES | _TABLES | _NOTES and marker != _SOS:
            segment = _OTHER_FRAMES.get(marker, f"the bytes FF {marker:02X}")
            raise ImageError(
                "JPEG: expected a baseline or progressive image and nothing between "
                f"its segments, found {segment} at byte {position - 2}"
            )
        # Where a segment's content begins and ends
        content = self.content
        if position + 2 > len(content):
            raise _ends_too_early(content)
        (length,) = struct.unpack_from(">H", content, position)
        end: int = position + length
        if length < 2 or end > len(content):
            raise ImageError("JPEG: the file ends too early, inside its header")
        start = position + 2
        if marker in _FRAMES:
            if self.header is not None:
                raise ImageError("JPEG: expected one frame, found another")
            self.header = _frame_header(content, start, end)
            *_, channels = self.header
            # A scan has all of a channel, or, in a progressive picture, a part of it.
            self.max_scans = _MAX_SCANS if marker == _PROGRESSIVE else channels
        elif marker == _SOS:
            self._check_scan(content[start:end])
        return end

    def _check_scan(self, body: bytes) -> None:
        if self.header is None:
            raise ImageError("JPEG: found no header with a size before the pixels")
        *_, most = self.header
        channels = body[0] if body else 0
        if not 1 <= channels <= most or len(body) != 4 + 2 * channels:
            raise ImageError(
                f"JPEG: a scan of {channels} channels with {len(body)} bytes in an "
                f"image of {most} channels"
            )
        self.scans += 1
        if self.scans > self.max_scans:
            raise ImageError(
                f"JPEG: expected at most {self.max_scans} scans, found more"
            )

    def finished(self) -> tuple[int, int, int]:
        """What its header says, if there was one and pixels after it."""
        if self.header is None:
            raise ImageError("JPEG: found no header with a size")
        if not self.scans:
            raise ImageError("JPEG: found no pixels")
        return self.header


def _frame_header(content: bytes | mmap, start: int, end: int) -> tuple[int, int, int]:
    if end - start < 6:
        raise ImageError("JPEG: found no header with a size")
    bit_depth, height, width, channels = struct.unpack_from(">BHHB", content, start)
    if channels not in (1, 3, 4):
        raise ImageError(f"JPEG: expected 1, 3 or 4 channels, found {channels}")
    if bit_depth != 8:
        raise ImageError(f"JPEG: expected 8 bits per channel, found {bit_depth}")
    if end - start != 6 + 3 * channels:
        raise ImageError(
            f"JPEG: a header of {channels} channels has {6 + 3 * channels} bytes, "
            f"found {end - start}"
        )
    return width, height, channels


def _end_of_scan(content: bytes | mmap, position: int) -> int:
    """Where the marker is that ends the coded pixels."""
    while position < len(content):
        # One byte more: a marker has two.
        marker = _MARKER_IN_SCAN.search(content, position, position + _WINDOW + 1)
        if marker is not None:
            return marker.start()
        position += _WINDOW
    raise _ends_too_early(content)


def _ends_too_early(content: bytes | mmap) -> ImageError:
    return ImageError(f"JPEG: the file ends too early, after {len(content)} bytes")
