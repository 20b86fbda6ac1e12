"""A segmentation that has been read: its pixels as codes, and what the codes mean."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from filter_core.images.pixels import Codes, PixelValues, codes_of, values_of
from filter_core.segmentation.codes import (
    KNOWN_COLORS,
    N_COLORS,
    NO_FAMILY,
    ChannelOrder,
    exact_codes,
)
from filter_core.types import UNKNOWN_TAG, IntArray, TagImage


@dataclass(frozen=True, eq=False)
class PixelCodes:
    """Pixels with a small code each; nothing is converted before it is asked for.

    Attributes
    ----------
    pixels : (H, W) uint8, or (H, W, 3) uint8
        The codes themselves; or red, green, blue, whose codes are `exact_codes`.
    tag_of_code : (256,) uint8
        The tag that a code means; 255 is Unknown.
    occurring : tuple of int
        The codes that occur in the image, in ascending order.
    """

    pixels: NDArray[np.uint8]
    tag_of_code: NDArray[np.uint8]
    occurring: tuple[int, ...]

    @classmethod
    def of_tags(cls, tags: TagImage, known: int, counts: IntArray) -> PixelCodes:
        """Tags that are their own codes; those from `known` on are Unknown."""
        tag_of_code = np.full(256, UNKNOWN_TAG, dtype=np.uint8)
        tag_of_code[:known] = np.arange(known)
        return cls(tags, tag_of_code, tuple(np.flatnonzero(counts).tolist()))

    @property
    def hw(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.pixels.shape[0], self.pixels.shape[1]

    def codes_of(self, values: PixelValues) -> Codes:
        """The codes of some values."""
        return codes_of(values, exact_codes())

    def value_of(self, code: int) -> int:
        """The one number that has this code; not for the code of no family."""
        if self.pixels.ndim == 2:
            return code
        if code == NO_FAMILY:
            raise ValueError("colours of no family have many values")
        return KNOWN_COLORS[code - 1] - N_COLORS

    def crop(self, x0: int, y0: int, x1: int, y1: int) -> Codes:
        """The codes of columns x0..x1-1 and rows y0..y1-1; not to be written to."""
        return self.codes_of(values_of(self.pixels[y0:y1, x0:x1]))


@dataclass(frozen=True, eq=False)
class Segmentation:
    """A segmentation image, decoded, and what was recognised.

    Attributes
    ----------
    codes : PixelCodes
    family : key of `filter_core.palettes.FAMILIES`
    encoding : ``palette`` or ``raw``
    channel_order : ``rgb`` or ``bgr``
    lossy : bool
        Tags were found by the nearest colour.
    unknown_pixels : px without a tag of the family
    foreign_percent : percent of the image
        Those of them whose colour is exactly one of another family.
    notes : tuple of str
        What a person should know about the reading.
    rivals : tuple of str
        Families that explain the same colours, but call some of them otherwise.
    """

    codes: PixelCodes
    family: str
    encoding: str
    channel_order: ChannelOrder
    lossy: bool = False
    unknown_pixels: int = 0
    foreign_percent: float = 0.0
    notes: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()

    @property
    def height(self) -> int:
        """Rows, px."""
        return self.codes.hw[0]

    @property
    def width(self) -> int:
        """Columns, px."""
        return self.codes.hw[1]

    @property
    def wh(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.width, self.height

    @property
    def unknown_percent(self) -> float:
        """Percent of the image without a tag of the family."""
        return 100.0 * self.unknown_pixels / (self.width * self.height)

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """As decoded: (H, W) tags, or (H, W, 3) red, green, blue."""
        return self.codes.pixels

    @cached_property
    def tags(self) -> TagImage:
        """(H, W) uint8, 255 is Unknown; computed when first asked for, read-only."""
        tags = self.tags_in(0, 0, self.width, self.height)
        tags.setflags(write=False)
        return tags

    def tags_in(self, x0: int, y0: int, x1: int, y1: int) -> TagImage:
        """A new array with the tags of columns x0..x1-1 and rows y0..y1-1."""
        codes = self.codes.crop(x0, y0, x1, y1)
        tags: TagImage = self.codes.tag_of_code[codes]
        return tags
