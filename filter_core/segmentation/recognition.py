"""Recognises the tag family and the channel order of the colours that occur.

Colours decide, never the share of pixels: an image of carla-0.9.14 can be explained to
99.6 % by the palette of carla-0.9.10, and a swapped Sky equals Rock.

`recognise` takes the codes of the colours that occur and what the caller has named
(`NamedReading`), and returns the `Recognition`, or raises `SegmentationError` where it
would have to guess.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final, NamedTuple

from filter_core.arrays import UNKNOWN_TAG
from filter_core.errors import SegmentationError
from filter_core.images.pixels import ChannelOrder
from filter_core.segmentation.codes import KNOWN_COLORS, ORDERS, tags_of_codes, unpacked
from filter_core.segmentation.palettes import (
    FAMILIES,
    PAPER_TABLE,
    RGB,
    UNCHANGED,
    ChangedTags,
    palette_of,
)

_NEWEST_FIRST: Final = (
    *(family for family in reversed(list(FAMILIES)) if family != PAPER_TABLE),
    PAPER_TABLE,
)


class Reading(NamedTuple):
    """An interpretation of colours: a tag family and an order of channels."""

    family: str
    order: ChannelOrder

    def missing(self, codes: frozenset[int]) -> frozenset[int]:
        """The colours that this reading does not explain."""
        tags = tags_of_codes(self.family, self.order)
        return frozenset(code for code in codes if tags[code] == UNKNOWN_TAG)

    def name_of(self, code: int) -> str:
        """The name of a colour's tag in this reading."""
        return palette_of(self.family).name_of(
            int(tags_of_codes(self.family, self.order)[code])
        )


@dataclass(frozen=True)
class NamedReading:
    """The family and order that were named instead of left to recognition.

    Attributes
    ----------
    family, order : str or None
        None: not named.
    sources : mapping or None
        Who named each of them, for errors. Not compared, so that `recognise` finds what
        it has cached whoever named them.
    changed : ChangedTags
        Of a changed CARLA. Not compared either: `recognise` is not asked about them.
    """

    family: str | None = None
    order: ChannelOrder | None = None
    sources: Mapping[str, str] | None = field(default=None, compare=False)
    changed: ChangedTags = field(default=UNCHANGED, compare=False)

    def source(self, what: str) -> str:
        """Who named it, for an error's text."""
        return (self.sources or {}).get(what, "the caller")

    def allows(self, reading: Reading) -> bool:
        """Whether this reading agrees with all that was named."""
        return self.family in (None, reading.family) and self.order in (
            None,
            reading.order,
        )


@dataclass(frozen=True)
class Recognition:
    """The reading that was chosen.

    Attributes
    ----------
    family, order
    rivals : tuple of str
        Families that explain the same colours, but call some of them otherwise. They
        matter only to a class whose accepted colours differ.
    missing : frozenset of int
        Codes of other families' colours.
    notes : tuple of str
        What a person should know about the choice.
    readings : frozenset of Reading
        All that leave as few colours unexplained, the chosen one among them.
    """

    family: str
    order: ChannelOrder
    rivals: tuple[str, ...]
    missing: frozenset[int]
    notes: tuple[str, ...]
    readings: frozenset[Reading]


def recognise(occurring: Iterable[int], named: NamedReading) -> Recognition:
    """Choose the family and channel order of a palette-coloured image.

    `occurring` are the codes of the known colours that occur.

    Raises
    ------
    SegmentationError
        ``segmentation_contradiction``: what is named leaves colours unexplained that
        another reading explains, without explaining any itself that the other does
        not. ``ambiguous_palette``: the colours belong to several families at once.

    Notes
    -----
    The reading that leaves the fewest colours (not pixels) unexplained is chosen. A
    tie is broken in favour of what CARLA renders over the paper's table, of ``rgb``,
    and of the newer family; `Recognition.rivals` and the notes say so.
    """
    return _recognise(frozenset(occurring), named)


# Frames of one recording have few sets of colours. Errors are not cached: each says who
# named what.
@lru_cache(maxsize=256)
def _recognise(codes: frozenset[int], named: NamedReading) -> Recognition:
    missing = {
        reading: reading.missing(codes)
        for reading in (Reading(f, o) for f in _NEWEST_FIRST for o in ORDERS)
    }
    allowed = [reading for reading in missing if named.allows(reading)]
    fewest = min(len(missing[reading]) for reading in allowed)
    best = [reading for reading in allowed if len(missing[reading]) == fewest]
    # CARLA before the paper's table, then rgb, then the newest
    chosen = min(best, key=lambda r: (r.family == PAPER_TABLE, r.order != "rgb"))
    for other, unexplained in missing.items():
        if not unexplained < missing[chosen]:
            continue
        code = min(missing[chosen] - unexplained)
        proof = f"{color_of(code, other.order)} is {other.name_of(code)} there"
        if other.order != chosen.order and named.order is not None:
            raise contradiction(
                f"{named.source('channel_order')} says channel_order {chosen.order}, "
                f"the colours that occur prove {other.order}: {proof}"
            )
        # The paper's table is meant for images of other families.
        if named.family not in (None, PAPER_TABLE) and other.family != PAPER_TABLE:
            raise contradiction(
                f"{named.source('palette')} says palette {chosen.family}, "
                f"the colours that occur prove {other.family}: {proof} "
                f"and no colour of {chosen.family}"
            )
    equals = [reading for reading in best if reading.order == chosen.order]
    if named.family is None:
        _refuse_mixture(chosen, equals, missing)
    explained = codes - missing[chosen]
    rivals = tuple(
        other.family
        for other in equals
        if other.family not in (chosen.family, PAPER_TABLE)
        and any(other.name_of(code) != chosen.name_of(code) for code in explained)
    )
    return Recognition(
        family=chosen.family,
        order=chosen.order,
        rivals=rivals,
        missing=missing[chosen],
        notes=tuple(_notes(chosen, best, rivals, explained)),
        readings=frozenset(best),
    )


def color_of(code: int, order: ChannelOrder) -> RGB:
    """The colour of a code as red, green, blue, for either order in the file."""
    red, green, blue = unpacked(KNOWN_COLORS[code - 1])
    return (red, green, blue) if order == "rgb" else (blue, green, red)


def contradiction(text: str) -> SegmentationError:
    """The error for a segmentation that contradicts the named options."""
    return SegmentationError(text, code="segmentation_contradiction")


def _refuse_mixture(
    chosen: Reading, equals: list[Reading], missing: Mapping[Reading, frozenset[int]]
) -> None:
    """Refuse colours of several families of which none has all."""
    for other in equals:
        if other.family == PAPER_TABLE or missing[other] == missing[chosen]:
            continue
        lacking = color_of(min(missing[other] - missing[chosen]), chosen.order)
        foreign = color_of(min(missing[chosen] - missing[other]), chosen.order)
        raise SegmentationError(
            f"the colours that occur belong to {chosen.family} and {other.family} at "
            f"once: only {chosen.family} has {lacking}, only {other.family} has "
            f"{foreign}; name the palette",
            code="ambiguous_palette",
        )


def _notes(
    chosen: Reading,
    best: list[Reading],
    rivals: tuple[str, ...],
    explained: frozenset[int],
) -> Iterable[str]:
    told = {chosen.family, PAPER_TABLE, *rivals}
    same = [
        reading.family
        for reading in best
        if reading.order == chosen.order and reading.family not in told
    ]
    if same:
        yield (
            f"read as {chosen.family}; {' and '.join(same)} would mean the same by "
            "the colours that occur"
        )
    for rival in rivals:
        other = Reading(rival, chosen.order)
        code = min(c for c in explained if other.name_of(c) != chosen.name_of(c))
        yield (
            f"read as {chosen.family}; {rival} has the same colours, but calls "
            f"{color_of(code, chosen.order)} {other.name_of(code)} instead of "
            f"{chosen.name_of(code)}"
        )
    if any(
        reading.order != chosen.order
        and any(reading.name_of(code) != chosen.name_of(code) for code in explained)
        for reading in best
    ):
        yield "the colours that occur do not tell the channel order; read as rgb"
    if chosen.order == "bgr":
        yield "red and blue are swapped in the file; read as bgr"
