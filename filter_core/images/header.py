"""Reads the header of a PNG or JPEG file, without decoding its pixels."""

from __future__ import annotations

from dataclasses import dataclass
from mmap import mmap
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.errors import ImageError, ImageSizeMismatch, ImageTooLarge
from filter_core.images.jpeg import read_jpeg
from filter_core.images.png import SIGNATURE, read_png

MAX_SIDE: Final = 16_384
"""Default limit for width and height, px; a decoded pixel takes up to four bytes."""

ColorModel: TypeAlias = Literal["grey", "grey_alpha", "rgb", "rgba", "indexed", "cmyk"]

_PNG_MODELS: Final[dict[int, ColorModel]] = {
    0: "grey",
    2: "rgb",
    3: "indexed",
    4: "grey_alpha",
    6: "rgba",
}

_JPEG_MODELS: Final[dict[int, ColorModel]] = {1: "grey", 3: "rgb", 4: "cmyk"}


@dataclass(frozen=True)
class ImageHeader:
    """The properties of an image according to its header.

    Attributes
    ----------
    media_type : ``image/png`` or ``image/jpeg``
    width, height : px, as stored; a rotation in EXIF is not applied
    bit_depth : bits per channel, or per index
    color_model : ``indexed`` is a PNG with a palette of its own
    """

    media_type: str
    width: int
    height: int
    bit_depth: int
    color_model: ColorModel

    @property
    def wh(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.width, self.height


def read_image_header(
    content: bytes | mmap, *, max_side: int = MAX_SIDE, whole: bool = True
) -> ImageHeader:
    """The header of a PNG or JPEG, recognised by its content.

    Parameters
    ----------
    content : bytes, or a mapped file
        The whole file: a file that ends too early is refused.
    max_side : int, px
        Checked before anything is decoded, so that a header cannot ask for gigabytes.
    whole : bool
        True: the whole file is checked, also between its segments or chunks, so that a
        decoder finds an image as the header describes it, in time bounded by the file's
        size.
        False: only the part up to the first pixels is checked. For files that are not
        decoded, or that Unghost has written.

    Raises
    ------
    ImageTooLarge
        If a side exceeds `max_side`.
    ImageError
        If it is neither PNG nor JPEG, ends too early, is animated, contradicts its
        format, or contains data that no camera and no program writes.

    References
    ----------
    .. [1] W3C, "Portable Network Graphics (PNG) Specification", third edition.
    .. [2] ITU-T T.81, "Digital compression and coding of continuous-tone still images".
    """
    if content[:8] == SIGNATURE:
        png = read_png(content, whole=whole)
        model = _PNG_MODELS[png.color_type]
        header = ImageHeader("image/png", png.width, png.height, png.bit_depth, model)
    elif content[:3] == b"\xff\xd8\xff":
        width, height, channels = read_jpeg(content, whole=whole)
        header = ImageHeader("image/jpeg", width, height, 8, _JPEG_MODELS[channels])
    else:
        text = f"{len(content)} bytes that begin with {content[:8]!r}"
        raise ImageError(
            f"expected a PNG or JPEG file, found {text if content else 'no bytes'}"
        )
    _check_sides(header.wh, max_side)
    return header


def read_image_size(start: bytes) -> tuple[int, int]:
    """Width and height, px, of a PNG or JPEG, from its first bytes.

    Of a PNG 24 are enough, of a JPEG those up to its frame header. The rest of the file
    is not checked.

    Raises
    ------
    ImageTooLarge
        If a side exceeds `MAX_SIDE`.
    ImageError
        If it is neither PNG nor JPEG, or these bytes do not say it.
    """
    if start[:8] != SIGNATURE:
        return read_image_header(start, whole=False).wh
    if start[12:16] != b"IHDR" or len(start) < _PNG_SIZE_ENDS:
        raise ImageError("PNG: the file ends too early, or has no header")
    width, height = (int.from_bytes(start[at : at + 4], "big") for at in (16, 20))
    _check_sides((width, height), MAX_SIDE)
    return width, height


_PNG_SIZE_ENDS: Final = 24


def _check_sides(wh: tuple[int, int], max_side: int) -> None:
    width, height = wh
    if min(wh) < 1:
        raise ImageError(f"the header says {width} x {height} pixels")
    if max(wh) > max_side:
        raise ImageTooLarge(
            f"the header says {width} x {height} pixels, no side may exceed {max_side}"
        )


def header_of(content: bytes | NDArray[np.uint8], max_side: int) -> ImageHeader:
    """The header of a file, or that which a PNG of (H, W, 3) uint8 would have.

    Raises `ImageError`: pixels have another form; and what `read_image_header` raises.
    """
    if not isinstance(content, np.ndarray):
        return read_image_header(content, max_side=max_side)
    if content.shape[2:] != (3,):
        raise ImageError(f"pixels: expected (H, W, 3), found {content.shape}")
    if content.dtype != np.uint8:
        raise ImageError(f"pixels: expected uint8, found {content.dtype}")
    height, width, _ = content.shape
    return ImageHeader("image/png", width, height, 8, "rgb")


def require_size(
    header: ImageHeader, expected_wh: tuple[int, int], *, what: str, than: str
) -> None:
    """Refuse an image whose size is not the expected one, (width, height) in px.

    `what` is the image and `than` what it is compared with, as the error names them.
    Raises `ImageSizeMismatch`: such as "the segmentation is 800 x 600, the image is
    1280 x 720".
    """
    if header.wh != tuple(expected_wh):
        width, height = expected_wh
        raise ImageSizeMismatch(
            f"{what} is {header.width} x {header.height} pixels, "
            f"{than} is {width} x {height}{exchanged_sides(header.wh, expected_wh)}"
        )


def exchanged_sides(wh: tuple[int, int], other_wh: tuple[int, int]) -> str:
    """What an error about two sizes adds if one is the other, turned by a quarter."""
    width, height = wh
    if width == height or (height, width) != tuple(other_wh):
        return ""
    return (
        "; a quarter turn that EXIF names is not applied: save the image as it is seen"
    )
