"""What a PNG or JPEG says about itself, read from its bytes without decoding them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from mmap import mmap
from typing import Final, Literal, TypeAlias

from filter_core.errors import ImageError, ImageSizeMismatch, ImageTooLarge

MAX_SIDE: Final = 16_384
"""Default limit for width and height, px; a decoded pixel takes up to four bytes."""

ColorModel: TypeAlias = Literal["grey", "grey_alpha", "rgb", "rgba", "indexed", "cmyk"]

_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_PNG_END: Final = b"IEND\xaeB`\x82"
_PNG_TAIL: Final = 4096
"""How much may follow the end: some cameras and editors append notes of their own."""
_PNG_MODELS: Final[dict[int, tuple[ColorModel, int]]] = {
    0: ("grey", 1),
    2: ("rgb", 3),
    3: ("indexed", 1),
    4: ("grey_alpha", 2),
    6: ("rgba", 4),
}
_JPEG_MODELS: Final[dict[int, ColorModel]] = {1: "grey", 3: "rgb", 4: "cmyk"}
_JPEG_END: Final = b"\xff\xd9"
# Frame headers SOF0..SOF15; C4, C8 and CC lie among them and mean other things.
_JPEG_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_BARE: Final = frozenset({0x01, *range(0xD0, 0xD9)})


@dataclass(frozen=True)
class ImageHeader:
    """What an image file promises to contain.

    Attributes
    ----------
    media_type : ``image/png`` or ``image/jpeg``
    width, height : px, as stored; a rotation in EXIF is not applied
    bit_depth : bits per channel, or per index
    channels : 1, 2, 3 or 4 as stored; an indexed image has one
    color_model : ``indexed`` is a PNG with a palette of its own
    """

    media_type: str
    width: int
    height: int
    bit_depth: int
    channels: int
    color_model: ColorModel

    @property
    def wh(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.width, self.height


def read_image_header(
    content: bytes | mmap, *, max_side: int = MAX_SIDE
) -> ImageHeader:
    """The header of a PNG or JPEG, recognised by its content.

    Parameters
    ----------
    content : bytes, or a mapped file, of which only the ends are read
        The whole file: a file that ends too early is refused.
    max_side : int, px
        Checked before anything is decoded, so that a header cannot ask for gigabytes.

    Raises
    ------
    ImageTooLarge
        If a side exceeds `max_side`.
    ImageError
        If it is neither PNG nor JPEG, ends too early, is animated, or contradicts its
        format.

    References
    ----------
    .. [1] W3C, "Portable Network Graphics (PNG) Specification", third edition.
    .. [2] ITU-T T.81, "Digital compression and coding of continuous-tone still images".
    """
    if content[:8] == _PNG_SIGNATURE:
        header = _png_header(content)
    elif content[:3] == b"\xff\xd8\xff":
        header = _jpeg_header(content)
    else:
        found = f"{len(content)} bytes that begin with {content[:8]!r}"
        raise ImageError(
            f"expected a PNG or JPEG file, found {found if content else 'no bytes'}"
        )
    if min(header.wh) < 1:
        raise ImageError(f"the header says {header.width} x {header.height} pixels")
    if max(header.wh) > max_side:
        raise ImageTooLarge(
            f"the header says {header.width} x {header.height} pixels, "
            f"no side may exceed {max_side}"
        )
    return header


def require_size(
    header: ImageHeader, expected_wh: tuple[int, int], *, what: str, than: str
) -> None:
    """Refuse an image whose size is not the expected one.

    Raises
    ------
    ImageSizeMismatch
        Such as "the segmentation is 800 x 600, the image is 1280 x 720".
    """
    if header.wh != tuple(expected_wh):
        width, height = expected_wh
        raise ImageSizeMismatch(
            f"{what} is {header.width} x {header.height} pixels, "
            f"{than} is {width} x {height}"
        )


def _png_header(content: bytes | mmap) -> ImageHeader:
    chunks = _png_chunks(content)
    kind, body = next(chunks)
    if kind != b"IHDR" or len(body) != 13:
        raise ImageError("PNG: expected a header of 13 bytes first")
    width, height, bit_depth, color_type, *_ = struct.unpack(">IIBBBBB", body)
    if color_type not in _PNG_MODELS or bit_depth not in (1, 2, 4, 8, 16):
        raise ImageError(
            f"PNG: unknown colour type {color_type} with bit depth {bit_depth}"
        )
    # What matters stands before the pixels; an animation has to announce itself there.
    kinds = {kind for kind, _ in chunks}
    if b"acTL" in kinds:
        raise ImageError("expected one picture, found an animated PNG")
    if b"IDAT" not in kinds:
        raise ImageError("PNG: found no pixels")
    if _PNG_END not in content[-_PNG_TAIL:]:
        raise _ends_too_early(content)
    model, channels = _PNG_MODELS[color_type]
    return ImageHeader("image/png", width, height, bit_depth, channels, model)


def _png_chunks(content: bytes | mmap) -> Iterator[tuple[bytes, bytes]]:
    """Each chunk's kind and first bytes, up to the first with pixels or the end."""
    position = len(_PNG_SIGNATURE)
    while position + 12 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, position)
        body = content[position + 8 : position + 8 + min(length, 64)]
        position += 12 + length
        if position > len(content):
            break
        yield kind, body
        if kind in (b"IDAT", b"IEND"):
            return
    raise _ends_too_early(content)


def _ends_too_early(content: bytes | mmap) -> ImageError:
    return ImageError(f"PNG: the file ends too early, after {len(content)} bytes")


def _jpeg_header(content: bytes | mmap) -> ImageHeader:
    if content.rfind(_JPEG_END) < 0:
        raise ImageError(f"JPEG: the file ends too early, after {len(content)} bytes")
    for marker, start, end in _jpeg_segments(content):
        if marker in _JPEG_FRAMES:
            if end - start < 6:
                break
            bit_depth, height, width, channels = struct.unpack_from(
                ">BHHB", content, start
            )
            if channels not in _JPEG_MODELS:
                raise ImageError(f"JPEG: expected 1, 3 or 4 channels, found {channels}")
            model = _JPEG_MODELS[channels]
            return ImageHeader("image/jpeg", width, height, bit_depth, channels, model)
    raise ImageError("JPEG: found no header with a size")


def _jpeg_segments(content: bytes | mmap) -> Iterator[tuple[int, int, int]]:
    """Marker, start and end of each segment's body, up to the first scan."""
    position = 2
    while position + 4 <= len(content) and content[position] == 0xFF:
        marker = content[position + 1]
        if marker == 0xFF:  # padding
            position += 1
        elif marker in _JPEG_BARE:
            position += 2
        elif marker in (0xD9, 0xDA):
            return
        else:
            (length,) = struct.unpack_from(">H", content, position + 2)
            end = position + 2 + length
            if length < 2 or end > len(content):
                raise ImageError("JPEG: the file ends too early, inside its header")
            yield marker, position + 4, end
            position = end
