"""Read raw tags: the number itself, in a grey image or in the red channel."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.errors import SegmentationError
from filter_core.images.pixels import count_codes
from filter_core.segmentation.codes import ChannelOrder, exact_codes
from filter_core.segmentation.palettes import FAMILIES, PAPER_TABLE, palette_of
from filter_core.segmentation.pixel_codes import PixelCodes, Segmentation
from filter_core.segmentation.recognition import Named
from filter_core.types import UNKNOWN_TAG, IntArray, TagImage

_PROVING_FAMILY: Final = "carla-0.9.14"
"""The only family of CARLA's with tags from 23 on."""

_LAST_TAG: Final = max(len(palette.tags) for palette in FAMILIES.values()) - 1

_MAX_SENSELESS_PERCENT: Final = 1.0

_RED, _GREEN, _BLUE = 0, 1, 2


def looks_raw(rgb: NDArray[np.uint8]) -> bool:
    """Whether all that an image has are small numbers in red alone, or blue alone."""
    red, green, blue = (_maximum(rgb, channel) for channel in (_RED, _GREEN, _BLUE))
    return green == 0 and (red == 0) != (blue == 0) and red + blue <= _LAST_TAG


def read_raw_channel(rgb: NDArray[np.uint8], named: Named) -> Segmentation:
    """Raw tags in the red channel, or in blue if it alone has any.

    Raises
    ------
    SegmentationError
        ``segmentation_contradiction``: the channel of the order that was named is
        empty and the other is not; and what `read_raw_tags` raises.
    """
    only_blue = _maximum(rgb, _RED) == 0 and _maximum(rgb, _BLUE) > 0
    only_red = _maximum(rgb, _BLUE) == 0 and _maximum(rgb, _RED) > 0
    order: ChannelOrder = named.order or ("bgr" if only_blue else "rgb")
    if (order == "rgb" and only_blue) or (order == "bgr" and only_red):
        raise SegmentationError(
            f"{named.source('channel_order')} says channel_order {order}, but the raw "
            f"tags are in the {'blue' if only_blue else 'red'} channel alone",
            code="segmentation_contradiction",
        )
    channel = cv2.extractChannel(rgb, _RED if order == "rgb" else _BLUE)
    return read_raw_tags(channel.astype(np.uint8, copy=False), named, order)


def read_raw_tags(
    tags: TagImage, named: Named, order: ChannelOrder = "rgb"
) -> Segmentation:
    """Raw tags of a family that is named, or proved by tags from 23 on.

    Parameters
    ----------
    tags : (H, W) uint8
    named : Named
    order : for the answer's `channel_order`

    Raises
    ------
    SegmentationError
        ``foreign_tags``: more than 1 % of the pixels have tags of no family;
        ``segmentation_contradiction``: tags occur that the named family does not have;
        ``family_not_named``: nothing names the family and nothing proves it.
    """
    counts = count_codes(tags, exact_codes())
    _refuse_senseless(counts)
    family = named.family or _proved_family(counts)
    _refuse_contradiction(counts, family, named)
    return raw_segmentation(tags, counts, family, order)


def raw_segmentation(
    tags: TagImage, counts: IntArray, family: str, order: ChannelOrder
) -> Segmentation:
    """Tags of a known family; others are Unknown, counted and noted."""
    known = len(palette_of(family).tags)
    unknown = int(counts[known:].sum())
    notes = [] if order == "rgb" else ["the raw tags are in the blue channel"]
    if unknown:
        share = 100.0 * unknown / float(counts.sum())
        notes.append(
            f"{share:.2f} % of the pixels have tags that {family} does not have; "
            "counted as Unknown"
        )
    return Segmentation(
        codes=PixelCodes.of_tags(tags, known, counts),
        family=family,
        encoding="raw",
        channel_order=order,
        unknown_pixels=unknown,
        notes=tuple(notes),
    )


def _maximum(rgb: NDArray[np.uint8], channel: int) -> int:
    return int(cv2.minMaxLoc(cv2.extractChannel(rgb, channel))[1])


def _refuse_senseless(counts: IntArray) -> None:
    senseless = counts[_LAST_TAG + 1 : UNKNOWN_TAG]
    share = 100.0 * float(senseless.sum()) / float(counts.sum())
    if share > _MAX_SENSELESS_PERCENT:
        commonest = _LAST_TAG + 1 + int(senseless.argmax())
        raise SegmentationError(
            f"{share:.1f} % of the pixels have raw tags of no family, most often "
            f"{commonest}; expected 0 to {_LAST_TAG}. "
            "A coloured segmentation needs encoding: palette",
            code="foreign_tags",
        )


def _proved_family(counts: IntArray) -> str:
    others = [
        len(palette.tags)
        for family, palette in FAMILIES.items()
        if family not in (_PROVING_FAMILY, PAPER_TABLE)
    ]
    if counts[max(others) : _LAST_TAG + 1].any():
        return _PROVING_FAMILY
    raise SegmentationError(
        "raw tags do not tell their family: 1 is Building in carla-0.9.10 and Road in "
        "carla-0.9.14. Name the palette in the dataset or the config, or give the "
        "frame's carla_version",
        code="family_not_named",
    )


def _refuse_contradiction(counts: IntArray, family: str, named: Named) -> None:
    if family == PAPER_TABLE:
        return
    known = len(palette_of(family).tags)
    beyond = np.flatnonzero(counts[known : _LAST_TAG + 1])
    if not len(beyond):
        return
    tag = known + int(beyond[-1])
    others = " or ".join(
        other
        for other, palette in FAMILIES.items()
        if tag < len(palette.tags) and other != PAPER_TABLE
    )
    raise SegmentationError(
        f"{named.source('palette')} says palette {family}, the raw tag {tag} that "
        f"occurs proves {others}",
        code="segmentation_contradiction",
    )
