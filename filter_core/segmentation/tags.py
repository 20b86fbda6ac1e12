"""Coloured or raw pixels become a `Segmentation`, or are refused.

There are three ways to read pixels: colours that are exactly those of a palette
(`read_exact_colors`), colours that a lossy format has changed
(`read_nearest_colors`), and raw tags, the numbers themselves, in a grey image
(`read_raw_tags`) or in one channel of a coloured one (`read_raw_channel`). Each counts
the colours or tags that occur, finds the family or takes the one that was named, notes
what is Unknown, and raises `SegmentationError` for an image that is hardly a
segmentation of that kind.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import UNKNOWN_TAG, IntArray, TagImage
from filter_core.errors import SegmentationError
from filter_core.images.pixels import (
    ChannelOrder,
    codes_of,
    count_codes,
    sampled,
    values_of,
)
from filter_core.segmentation.codes import (
    COLOR_BITS,
    KNOWN_COLORS,
    NO_FAMILY,
    ORDERS,
    PixelCodes,
    Segmentation,
    codes_with,
    exact_codes,
    nearest_tags,
    packed,
    recognisable_codes,
    tags_of_codes,
    unpacked,
)
from filter_core.segmentation.palettes import (
    FAMILIES,
    LAST_TAG,
    PAPER_TABLE,
    UNCHANGED,
    ChangedTags,
    palette_of,
)
from filter_core.segmentation.recognition import (
    NamedReading,
    Reading,
    Recognition,
    color_of,
    contradiction,
    recognise,
)

_MAX_SENSELESS_PERCENT: Final = 1.0
"""An image with a larger share of colours or tags of no family is refused."""

_LOSSY_FLOOR_PERCENT: Final = 0.1
"""A lossy colour must cover this much to count: blends at edges imitate others."""

_PROVING_FAMILY: Final = "carla-0.9.14"
"""The only family of CARLA's with tags from 23 on."""

_RED, _GREEN, _BLUE = 0, 1, 2


def read_exact_colors(
    pixels: NDArray[np.uint8], occurring: Sequence[int], named: NamedReading
) -> Segmentation:
    """A segmentation of pixels that are exactly colours of a palette.

    `pixels` are (H, W, 3) red, green, blue.
    `occurring` are the codes of the colours that occur, as `exact_codes` has them.

    Raises
    ------
    SegmentationError
        ``foreign_colors``: more than 1 % of the pixels have colours of no family; and
        what `recognise` raises.
    """
    changed = named.changed
    if NO_FAMILY in occurring:
        counts = count_codes(pixels, exact_codes(changed))
        _refuse_no_family(pixels, counts, [NO_FAMILY], changed)
    recognition = recognise(_family_codes(occurring, changed), named)
    tags = tags_of_codes(recognition.family, recognition.order, changed)
    segmentation = Segmentation(
        codes=PixelCodes(pixels, tags, tuple(occurring), changed),
        family=changed.target(recognition.family),
        encoding="palette",
        channel_order=recognition.order,
        notes=recognition.notes,
        rivals=_rivals(recognition, changed),
        readings=frozenset(recognition.readings),
    )
    unknown = [code for code in occurring if tags[code] == UNKNOWN_TAG]
    return _with_unknown(segmentation, unknown) if unknown else segmentation


def _family_codes(occurring: Iterable[int], changed: ChangedTags) -> set[int]:
    """The codes that occur of colours that a family has, and no changed CARLA."""
    codes = codes_with(changed)
    own = {codes[packed(rgb, order)] for rgb, _ in changed.colors for order in ORDERS}
    return set(occurring) - own - {NO_FAMILY}


def _rivals(recognition: Recognition, changed: ChangedTags) -> tuple[str, ...]:
    """Those of the recognition, if the tags keep the numbers of its family."""
    return (
        recognition.rivals
        if changed.target(recognition.family) == recognition.family
        else ()
    )


def _with_unknown(segmentation: Segmentation, unknown: Sequence[int]) -> Segmentation:
    """The same, with the codes without a tag counted: only then each pixel matters."""
    changed = segmentation.codes.changed
    counts = count_codes(segmentation.pixels, exact_codes(changed))
    # The first family that has a colour without a tag, by the colour's code
    readings = [Reading(family, segmentation.channel_order) for family in FAMILIES]
    foreign = {
        code: having[0]
        for code in unknown
        if (
            having := [
                reading
                for reading in readings
                if not reading.missing(frozenset({code}))
            ]
        )
    }
    no_family = [NO_FAMILY, *(code for code in unknown if code and code not in foreign)]
    _refuse_no_family(segmentation.pixels, counts, no_family, changed)
    return replace(
        segmentation,
        unknown_pixels=int(counts[[*foreign, *no_family]].sum()),
        notes=(*segmentation.notes, *_unknown_notes(counts, foreign, no_family)),
    )


def _refuse_no_family(
    pixels: NDArray[np.uint8],
    counts: IntArray,
    codes: Sequence[int],
    changed: ChangedTags,
) -> None:
    share = 100.0 * float(counts[codes].sum()) / float(counts.sum())
    if share <= _MAX_SENSELESS_PERCENT:
        return
    colors = values_of(pixels).reshape(-1) & COLOR_BITS
    odd, how_often = np.unique(
        colors[np.isin(exact_codes(changed)[colors], codes)], return_counts=True
    )
    red, green, blue = unpacked(int(odd[how_often.argmax()]))
    raise SegmentationError(
        f"{share:.1f} % of the pixels have colours of no known family, most often "
        f"({red}, {green}, {blue}); at most {_MAX_SENSELESS_PERCENT:g} % may. "
        f"{_remedy(pixels)}",
        code="foreign_colors",
    )


def _remedy(pixels: NDArray[np.uint8]) -> str:
    """What to do about colours of no family, as far as it helps with this image."""
    if all(_maximum(pixels, channel) <= LAST_TAG for channel in (_RED, _GREEN, _BLUE)):
        return "Raw tags need encoding: raw"
    if why := _unlike_palettes(pixels):
        return f"It is no segmentation that was a JPEG or was resized, either: {why}"
    return (
        "A palette image that was a JPEG or was resized needs "
        "lossy_segmentation: nearest"
    )


def _unknown_notes(
    counts: IntArray, foreign: Mapping[int, Reading], no_family: list[int]
) -> Iterable[str]:
    total = float(counts.sum())
    for code, reading in foreign.items():
        yield (
            f"{100.0 * counts[code] / total:.2f} % of the pixels are "
            f"{color_of(code, reading.order)}, {reading.name_of(code)} of "
            f"{reading.family}; counted as Unknown"
        )
    if pixels := int(counts[no_family].sum()):
        yield (
            f"{100.0 * pixels / total:.2f} % of the pixels have colours of no family; "
            "counted as Unknown"
        )


def read_nearest_colors(pixels: NDArray[np.uint8], named: NamedReading) -> Segmentation:
    """A segmentation of (H, W, 3) red, green, blue that a lossy format changed.

    Each pixel has the tag of the nearest colour.

    Raises
    ------
    SegmentationError
        ``foreign_colors``: the colours hardly resemble those of palettes; and what
        `recognise` raises.
    """
    refuse_unlike_palettes(pixels)
    near = count_codes(pixels, recognisable_codes())
    floor = _LOSSY_FLOOR_PERCENT / 100.0 * float(near.sum())
    occurring = set(np.flatnonzero(near >= floor).tolist()) - {NO_FAMILY}
    recognition = recognise(_family_codes(occurring, named.changed), named)
    table = nearest_tags(recognition.family, recognition.order, named.changed)
    tags = codes_of(values_of(pixels), table)
    counts = count_codes(tags, table)
    unknown = int(counts[UNKNOWN_TAG])
    share = 100.0 * unknown / float(counts.sum())
    return Segmentation(
        codes=PixelCodes.of_tags(tags, UNKNOWN_TAG, counts),
        family=named.changed.target(recognition.family),
        encoding="palette",
        channel_order=recognition.order,
        lossy=True,
        unknown_pixels=unknown,
        notes=(
            *recognition.notes,
            f"lossy: tags by the nearest colour, {share:.2f} % of the pixels "
            "are too far from any",
        ),
        rivals=_rivals(recognition, named.changed),
        readings=frozenset(recognition.readings),
    )


_NEAR_LEVELS: Final = 8
_FAR_LEVELS: Final = 32
"""Beyond these, per channel, a colour is not near a palette's, and far from all."""

_MOST_NOT_NEAR_PERCENT: Final = 40.0
"""JPEGs of palette images have up to 30 %, photos and other sensors 53 % and more."""

_MOST_FAR_PERCENT: Final = 20.0

_GREY_LEVELS: Final = 6
_MOST_GREY_PERCENT: Final = 95.0
"""Few colours of palettes are grey, but all of a depth image made for people."""


def refuse_unlike_palettes(pixels: NDArray[np.uint8]) -> None:
    """Refuse an image that cannot be a segmentation whose colours a JPEG has changed.

    `pixels` are (H, W, 3) red, green, blue. Raises `SegmentationError`
    (``foreign_colors``): it is a photo or another sensor's image, in which some colours
    happen to be near a palette's.
    """
    if why := _unlike_palettes(pixels):
        raise SegmentationError(
            f"expected a segmentation with the colours of a palette, found {why}",
            code="foreign_colors",
        )


def _unlike_palettes(pixels: NDArray[np.uint8]) -> str:
    """Why a sample of colours is not that of a changed palette image; "" if it is."""
    colors = sampled(pixels).reshape(-1, 3).astype(np.int16)
    # Black is a tag of every family, and any image may have dark parts.
    colors = colors[colors.max(axis=1) > _NEAR_LEVELS]
    if not len(colors):
        return ""
    grey = 100.0 * float(np.mean(np.ptp(colors, axis=1) <= _GREY_LEVELS))
    if grey > _MOST_GREY_PERCENT:
        return (
            f"an image in which {grey:.0f} % of the pixels that are not black are grey "
            f"(at most {_MOST_GREY_PERCENT:g} % may)"
        )
    nearest = np.full(len(colors), 255, np.int16)
    for color in KNOWN_COLORS:
        levels = np.abs(colors - np.array(unpacked(color), np.int16)).max(axis=1)
        np.minimum(nearest, levels, out=nearest)
    not_near, far = (
        100.0 * float(np.mean(nearest > levels))
        for levels in (_NEAR_LEVELS, _FAR_LEVELS)
    )
    if not_near <= _MOST_NOT_NEAR_PERCENT and far <= _MOST_FAR_PERCENT:
        return ""
    return (
        f"an image in which {not_near:.0f} % of the pixels are more than "
        f"{_NEAR_LEVELS} levels from every colour of the palettes (at most "
        f"{_MOST_NOT_NEAR_PERCENT:g} % may) and {far:.0f} % more than {_FAR_LEVELS} "
        f"(at most {_MOST_FAR_PERCENT:g} % may)"
    )


_BRIGHTEST_LOST_TAG: Final = LAST_TAG + 16
"""Rounding in a JPEG makes tags up to so much larger."""

_FEWEST_STEPS: Final = 64
_MOST_RIPPLES_PERCENT: Final = 8.0
"""Recorded segmentations have up to 5 %, also small ones; those that were a JPEG have
20 % and more, but from quality 98 on may have less than 8 %."""

_RIPPLE_PIXELS: Final = 1 << 16


def refuse_lost_tags(rgb: NDArray[np.uint8], *, is_jpeg: bool) -> None:
    """Refuse raw tags in a coloured JPEG, or in a PNG that was made of one.

    The colours of the (H, W, 3) image are not exactly those of a palette.

    Raises
    ------
    SegmentationError
        ``lossy_segmentation``

    Notes
    -----
    All numbers in a JPEG of raw tags are small. Those in a PNG may be exact raw tags if
    they are in one channel, or the same in all three, and have no ripples.
    """
    highest = [_maximum(rgb, channel) for channel in (_RED, _GREEN, _BLUE)]
    if not 0 < max(highest) <= _BRIGHTEST_LOST_TAG:
        return
    if is_jpeg:
        raise lost_tags("a JPEG that holds no other numbers than small ones")
    channel = cv2.extractChannel(rgb, int(np.argmax(highest)))
    _refuse_rippled(channel.astype(np.uint8, copy=False))
    is_single = sum(high > 0 for high in highest) == 1
    if not is_single and (rgb != channel[..., None]).any():
        raise lost_tags(
            "a PNG whose channels hold small numbers that differ, as if it was made of "
            "a JPEG. An instance image, whose red channel has exact tags, is read with "
            "encoding: raw"
        )


def lost_tags(found: str) -> SegmentationError:
    """The error for raw tags that were changed by a JPEG."""
    return SegmentationError(
        "raw tags in a JPEG are lost: one level off is another tag; expected the PNG "
        f"that CARLA wrote, found {found}",
        code="lossy_segmentation",
    )


def _refuse_rippled(tags: TagImage) -> None:
    """Refuse raw tags that were a JPEG: it leaves ripples of one level at edges.

    In an exact image, a line of one pixel is like a ripple if its tag is next to those
    beside it, as RoadLine is to Road and Sidewalk before CARLA 0.9.14. Such lines are
    of one tag, ripples of many, so those of the commonest tag are not counted.
    """
    rows = tags[:: max(1, tags.size // _RIPPLE_PIXELS)].astype(np.int16)
    steps = np.diff(rows, axis=1)
    count = np.count_nonzero(steps)
    if count < _FEWEST_STEPS:
        return
    before, after = steps[:, :-1], steps[:, 1:]
    by_one = (np.abs(before) == 1) | (np.abs(after) == 1)
    rippled = (before != 0) & (after != 0) & by_one
    ripples = np.count_nonzero(rippled)
    if 100.0 * ripples > _MOST_RIPPLES_PERCENT * count:
        ripples -= int(np.bincount(rows[:, 1:-1][rippled]).max())
    share = 100.0 * ripples / count
    if share > _MOST_RIPPLES_PERCENT:
        raise lost_tags(
            f"a PNG that was made of a JPEG: {share:.0f} % of the changes from pixel "
            f"to pixel are its ripples (at most {_MOST_RIPPLES_PERCENT:g} % may be)"
        )


def looks_raw(rgb: NDArray[np.uint8], last: int = LAST_TAG) -> bool:
    """Whether (H, W, 3) pixels have small numbers in red alone, or in blue alone.

    `last` is the largest of such numbers.
    """
    red, green, blue = (_maximum(rgb, channel) for channel in (_RED, _GREEN, _BLUE))
    return green == 0 and (red == 0) != (blue == 0) and red + blue <= last


def read_raw_channel(rgb: NDArray[np.uint8], named: NamedReading) -> Segmentation:
    """Raw tags in the red channel, or in blue if it alone has any.

    Raises
    ------
    SegmentationError
        ``segmentation_contradiction``: the channel of the order that was named is
        empty and the other is not; and what `read_raw_tags` raises.
    """
    red, blue = _maximum(rgb, _RED), _maximum(rgb, _BLUE)
    only_blue, only_red = red == 0 and blue > 0, blue == 0 and red > 0
    order: ChannelOrder = named.order or ("bgr" if only_blue else "rgb")
    if (order == "rgb" and only_blue) or (order == "bgr" and only_red):
        raise contradiction(
            f"{named.source('channel_order')} says channel_order {order}, but the raw "
            f"tags are in the {'blue' if only_blue else 'red'} channel alone"
        )
    if 0 < red < blue <= _BRIGHTEST_LOST_TAG:
        # Of tags in blue that were a JPEG, red has only remains.
        _refuse_rippled(cv2.extractChannel(rgb, _BLUE).astype(np.uint8, copy=False))
    channel = cv2.extractChannel(rgb, _RED if order == "rgb" else _BLUE)
    return read_raw_tags(channel.astype(np.uint8, copy=False), named, order)


def _maximum(rgb: NDArray[np.uint8], channel: int) -> int:
    return int(cv2.minMaxLoc(cv2.extractChannel(rgb, channel))[1])


def read_raw_tags(
    tags: TagImage, named: NamedReading, order: ChannelOrder = "rgb"
) -> Segmentation:
    """Raw tags of a family that is named, or proved by tags from 23 on.

    `tags` (H, W) may be multiples of `ChangedTags.scale`; `order` is the answer's
    `channel_order`.

    Raises
    ------
    SegmentationError
        ``foreign_tags``: more than 1 % of the pixels have tags of no family, or no
        multiples;
        ``lossy_segmentation``: they were a JPEG once;
        ``segmentation_contradiction``: tags occur that the named family does not have;
        ``family_not_named``: nothing names the family and nothing proves it.
    """
    changed = named.changed
    counts = count_codes(tags, exact_codes(UNCHANGED))
    if changed.scale > 1:
        others = np.where(np.arange(256) % changed.scale, counts, 0)
        share = 100.0 * float(others.sum()) / float(counts.sum())
        if share > _MAX_SENSELESS_PERCENT:
            raise SegmentationError(
                f"tag_scale: expected multiples of {changed.scale}, found other "
                f"numbers at {share:.1f} % of the pixels, most often "
                f"{int(others.argmax())}",
                code="foreign_tags",
            )
        tags = cv2.LUT(tags, changed.levels).astype(np.uint8, copy=False)
        counts = count_codes(tags, exact_codes(UNCHANGED))
    plain = counts.copy()
    plain[[number for number, _ in changed.numbers]] = 0
    # Refuse numbers of no family; `plain` are pixels of those that are not changed
    senseless = plain[LAST_TAG + 1 : UNKNOWN_TAG]
    share = 100.0 * float(senseless.sum()) / float(counts.sum())
    if share > _MAX_SENSELESS_PERCENT:
        commonest = LAST_TAG + 1 + int(senseless.argmax())
        raise SegmentationError(
            f"{share:.1f} % of the pixels have raw tags of no family, most often "
            f"{commonest}; expected 0 to {LAST_TAG}. {_remedy_of_numbers(counts)}",
            code="foreign_tags",
        )
    _refuse_rippled(tags)
    family = named.family or _proved_family(plain)
    _refuse_contradiction(plain, family, named)
    segmentation = raw_segmentation(tags, counts, family, order, changed)
    return replace(segmentation, readings=frozenset({(family, order)}))


_FEWEST_MULTIPLES: Final = 4
"""Different numbers; a mask has few, which are multiples of something."""


def _remedy_of_numbers(counts: IntArray) -> str:
    """What to do about raw numbers of no family, as far as the image tells."""
    numbers = np.flatnonzero(counts[:UNKNOWN_TAG])
    factor = int(np.gcd.reduce(numbers))
    is_scaled = factor > 1 and numbers[-1] // factor <= LAST_TAG
    if is_scaled and len(numbers) >= _FEWEST_MULTIPLES:
        return (
            f"All are multiples of {factor}: tag_scale: {factor} reads {numbers[-1]} "
            f"as {numbers[-1] // factor} (segmentation.scale in recording.yaml)"
        )
    return (
        "Tags of a changed CARLA are named by the key tags, as in {40: Pedestrian} "
        "(segmentation.tags in recording.yaml); a coloured segmentation needs "
        "encoding: palette"
    )


def _proved_family(counts: IntArray) -> str:
    others = [
        len(palette.tags)
        for family, palette in FAMILIES.items()
        if family not in (_PROVING_FAMILY, PAPER_TABLE)
    ]
    if counts[max(others) : LAST_TAG + 1].any():
        return _PROVING_FAMILY
    raise SegmentationError(
        "raw tags do not tell their family: 1 is Building in carla-0.9.10 and Road in "
        "carla-0.9.14. Name the palette in the dataset or the config, or give the "
        "frame's carla_version",
        code="family_not_named",
    )


def _refuse_contradiction(counts: IntArray, family: str, named: NamedReading) -> None:
    if family == PAPER_TABLE:
        return
    tag_count = len(palette_of(family).tags)
    beyond = np.flatnonzero(counts[tag_count : LAST_TAG + 1])
    if not len(beyond):
        return
    tag = tag_count + int(beyond[-1])
    others = " or ".join(
        other
        for other, palette in FAMILIES.items()
        if tag < len(palette.tags) and other != PAPER_TABLE
    )
    raise contradiction(
        f"{named.source('palette')} says palette {family}, the raw tag {tag} that "
        f"occurs proves {others}"
    )


def raw_segmentation(
    tags: TagImage,
    counts: IntArray,
    family: str,
    order: ChannelOrder,
    changed: ChangedTags = UNCHANGED,
) -> Segmentation:
    """Tags (H, W) of a known family; others are Unknown, counted and noted.

    `counts` (256,) are the pixels of each tag, `order` is the answer's `channel_order`.
    """
    tag_of_number = changed.tags_of_numbers(family)
    unknown = int(counts[tag_of_number == UNKNOWN_TAG].sum())
    notes = [] if order == "rgb" else ["the raw tags are in the blue channel"]
    if unknown:
        share = 100.0 * unknown / float(counts.sum())
        notes.append(
            f"{share:.2f} % of the pixels have tags that {family} does not have; "
            "counted as Unknown"
        )
    return Segmentation(
        codes=PixelCodes(tags, tag_of_number, tuple(np.flatnonzero(counts).tolist())),
        family=changed.target(family),
        encoding="raw",
        channel_order=order,
        unknown_pixels=unknown,
        notes=tuple(notes),
    )
