"""A code for each known colour, and a segmentation as pixels with codes.

Every colour of any tag family, in either channel order, has a number from 1, its code.
All other colours have code 0. So an image's colours can be looked up in one table
before its family is known; `tags_of_codes` returns the tag of each code in a family.

A colour is packed as ``R << 16 | G << 8 | B``: what four bytes B, G, R, A are as a
little-endian integer without A.

`Segmentation` is the result of reading a segmentation image: its `PixelCodes`, and the
recognised properties. Raw tags are their own codes there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import UNKNOWN_TAG, IntArray, TagImage
from filter_core.images.pixels import (
    ChannelOrder,
    Codes,
    PixelValues,
    codes_of,
    sampled,
    values_of,
)
from filter_core.segmentation.palettes import (
    FAMILIES,
    RGB,
    UNCHANGED,
    ChangedTags,
    palette_of,
)

ORDERS: Final[tuple[ChannelOrder, ...]] = ("rgb", "bgr")

NO_FAMILY: Final = 0
"""The code of all colours that no family has, in no channel order."""

_N_COLORS: Final = 1 << 24

COLOR_BITS: Final = _N_COLORS - 1
"""The bits of a pixel's value that are its packed colour; above them is alpha."""


def packed(rgb: RGB, order: ChannelOrder = "rgb") -> int:
    """A colour as one number of 24 bits, its channels packed in this order."""
    red, green, blue = rgb if order == "rgb" else rgb[::-1]
    return red << 16 | green << 8 | blue


def unpacked(color: int) -> RGB:
    """Red, green and blue of a packed colour: the inverse of `packed` for ``rgb``."""
    return color >> 16 & 255, color >> 8 & 255, color & 255


KNOWN_COLORS: Final = tuple(
    dict.fromkeys(
        packed(tag.rgb, order)
        for order in ORDERS
        for palette in FAMILIES.values()
        for tag in palette.tags
    )
)
"""Every colour of every family, in both channel orders; code = index + 1."""

CODE_OF: Final = {color: code for code, color in enumerate(KNOWN_COLORS, start=1)}


MAX_CHANGED_COLORS: Final = (255 - len(KNOWN_COLORS)) // len(ORDERS)
"""Colours of a changed CARLA that can have codes, too."""


@lru_cache(maxsize=16)
def codes_with(changed: ChangedTags) -> Mapping[int, int]:
    """The code of every known colour, and of those of a changed CARLA."""
    own = [packed(rgb, order) for rgb, _ in changed.colors for order in ORDERS]
    return {
        color: code for code, color in enumerate({**CODE_OF, **dict.fromkeys(own)}, 1)
    }


@lru_cache(maxsize=4)
def exact_codes(changed: ChangedTags) -> Codes:
    """(2^24,) uint8: the code of every packed colour.

    Almost all of it is zeros that were never written, so it takes 16 MiB of addresses
    and a few pages of memory.
    """
    codes = codes_with(changed)
    table = np.zeros(_N_COLORS, dtype=np.uint8)
    table[list(codes)] = list(codes.values())
    table.setflags(write=False)
    return table


_RECOGNISED_LEVELS: Final = 8
"""How near a lossy colour must be to count towards recognising its family."""


@lru_cache(maxsize=1)
def recognisable_codes() -> Codes:
    """(2^24,) uint8: the code whose colour is nearest, within 8 levels per channel."""
    colors = [(color, code) for color, code in CODE_OF.items()]
    return _nearest(colors, _RECOGNISED_LEVELS, default=NO_FAMILY)


_NEAREST_LEVELS: Final = 32
"""How far a lossy colour may be from a palette's, per channel."""


@lru_cache(maxsize=4)
def nearest_tags(
    family: str, order: ChannelOrder, changed: ChangedTags = UNCHANGED
) -> Codes:
    """(2^24,) uint8: the tag whose colour is nearest, within 32 levels per channel.

    Nearest in the Euclidean sense, the lower tag wins a tie; 255 where no colour is
    near, and where it is exactly the colour of another family.
    """
    tags = tags_of_codes(family, order, changed)
    own = {
        color: int(tags[code])
        for color, code in codes_with(changed).items()
        if tags[code] != UNKNOWN_TAG
    }
    by_tag = sorted(own.items(), key=lambda item: item[1])
    table = _nearest(by_tag, _NEAREST_LEVELS, default=UNKNOWN_TAG)
    foreign = [
        color
        for palette in FAMILIES.values()
        for tag in palette.tags
        if (color := packed(tag.rgb, order)) not in own
    ]
    table.setflags(write=True)
    table[foreign] = UNKNOWN_TAG
    table.setflags(write=False)
    return table


def _nearest(colors: list[tuple[int, int]], levels: int, *, default: int) -> Codes:
    """The value of the nearest of some packed colours, for every colour there is."""
    table = np.full((256, 256, 256), default, dtype=np.uint8)
    distance = np.full(table.shape, np.iinfo(np.uint16).max, dtype=np.uint16)
    steps = np.arange(-255, 256, dtype=np.int32) ** 2
    for color, value in colors:
        rgb = unpacked(color)
        cube = tuple(slice(max(0, c - levels), c + levels + 1) for c in rgb)
        red, green, blue = (
            steps[part.start - c + 255 : min(part.stop, 256) - c + 255]
            for part, c in zip(cube, rgb, strict=True)
        )
        far = red[:, None, None] + green[None, :, None] + blue[None, None, :]
        nearer = far < distance[cube]
        distance[cube][nearer] = far[nearer]
        table[cube][nearer] = value
    flat = table.reshape(-1)
    flat.setflags(write=False)
    return flat


@lru_cache(maxsize=16)
def tags_of_codes(
    family: str, order: ChannelOrder, changed: ChangedTags = UNCHANGED
) -> NDArray[np.uint8]:
    """(256,) uint8: the tag that each code means in a family; 255 where none.

    Of a changed CARLA: in `ChangedTags.target` of the family.
    """
    tags = np.full(256, UNKNOWN_TAG, dtype=np.uint8)
    renumbered = changed.renumbered(family)
    for tag in palette_of(family).tags:
        tags[CODE_OF[packed(tag.rgb, order)]] = renumbered[tag.tag]
    codes, target = codes_with(changed), palette_of(changed.target(family))
    for rgb, name in changed.colors:
        tags[codes[packed(rgb, order)]] = target.tag_of(name)
    tags.setflags(write=False)
    return tags


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
    changed : ChangedTags
        Colours that have codes of their own.
    """

    pixels: NDArray[np.uint8]
    tag_of_code: NDArray[np.uint8]
    occurring: tuple[int, ...]
    changed: ChangedTags = UNCHANGED

    @classmethod
    def of_tags(
        cls, tags: TagImage, first_unknown: int, counts: IntArray
    ) -> PixelCodes:
        """From a small number per pixel that is its own code: a tag, a mask's 0 or 1.

        Numbers from `first_unknown` on are Unknown; `counts` is the histogram of all.
        """
        tag_of_code = np.full(256, UNKNOWN_TAG, dtype=np.uint8)
        tag_of_code[:first_unknown] = np.arange(first_unknown)
        return cls(tags, tag_of_code, tuple(np.flatnonzero(counts).tolist()))

    @property
    def hw(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.pixels.shape[0], self.pixels.shape[1]

    def codes_of(self, values: PixelValues) -> Codes:
        """The codes of some values."""
        return codes_of(values, exact_codes(self.changed))

    def crop(self, x0: int, y0: int, x1: int, y1: int) -> Codes:
        """The codes of columns x0..x1-1 and rows y0..y1-1; not to be written to."""
        return self.codes_of(values_of(self.pixels[y0:y1, x0:x1]))


@dataclass(frozen=True, eq=False)
class Segmentation:
    """A segmentation image, decoded, and what was recognised.

    Attributes
    ----------
    family : key of `filter_core.segmentation.palettes.FAMILIES`
    encoding : ``palette`` or ``raw``
    channel_order : ``rgb`` or ``bgr``
    lossy : bool
        Tags were found by the nearest colour.
    unknown_pixels : px without a tag of the family
    notes : tuple of str
        What a person should know about the reading.
    rivals : tuple of str
        Families that explain the same colours, but call some of them otherwise.
    readings : frozenset of (str, ChannelOrder)
        Families and orders of channels that explain the colours as well as the one that
        was chosen, which is among them; empty of an array of tags.
    """

    codes: PixelCodes
    family: str
    encoding: Literal["palette", "raw"]
    channel_order: ChannelOrder
    lossy: bool = False
    unknown_pixels: int = 0
    notes: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()
    readings: frozenset[tuple[str, ChannelOrder]] = frozenset()

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
        codes = self.codes.crop(0, 0, self.width, self.height)
        tags: TagImage = self.codes.tag_of_code[codes]
        tags.setflags(write=False)
        return tags

    @property
    def sampled_tags(self) -> TagImage:
        """(h, w) uint8: the tags of the pixels that `sampled` gives; 255 is Unknown."""
        tags: TagImage = self.codes.tag_of_code[
            self.codes.codes_of(values_of(sampled(self.pixels)))
        ]
        return tags
