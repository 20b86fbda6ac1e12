"""Which boxes a person should be asked about, and which first.

Doubt is how much an answer is worth: how likely the filter errs, times how well an eye
can decide, times how much the answer teaches. Boxes that need no question are in bins
that are answered in bulk, if at all: see `Bin`. This is the only definition: the queue,
its counts, and "to review" of datasets and frames follow from it.

The likely errors were fitted on a street whose truth is known; docs/review.md has the
figures of another one, and the command that prints them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from enum import IntEnum
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, FloatArray, IntArray
from filter_core.config.filter import DecideConfig
from filter_core.decisions.channel_rules import (
    IS_FINAL,
    compared_by_channels,
    has_number,
    keeps,
)
from filter_core.decisions.explain import rounded_percent
from filter_core.decisions.rules import decide
from filter_core.evidence_kinds import CHANNELS, SEMANTIC, ChannelName, EvidenceName
from filter_core.evidence_numbers import Evidence
from filter_core.verdicts import (
    KEPT,
    REJECTED,
    UNMEASURED,
    VERDICT_OF_REASON,
    Decisions,
    Reason,
)

DOUBT_VERSION: Final = 2
"""To be increased with each change of what `doubts` gives: stored doubt is then made
anew when the service starts."""


class Bin(IntEnum):
    """What is to be done about boxes, from the first that the queue has to the last.

    The value is the least doubt of the boxes; all others but ASK have exactly this one.
    """

    ASK = 1
    """Boxes to ask a person about."""
    SURE = 0
    """The filter is as good as certain, or nothing of the box is in the image."""
    SMALL = -1
    """Their shorter side is less than `review_min_side`: an eye cannot decide."""
    WALL = -2
    """Rejected, and no pixel has a tag of their class: something hides all of it."""

    @property
    def label(self) -> BinName:
        """Its name on the wire."""
        return _LABELS[self]


BinName: TypeAlias = Literal["ask", "sure", "small", "wall"]

_LABELS: Final[Mapping[Bin, BinName]] = {
    Bin.ASK: "ask",
    Bin.SURE: "sure",
    Bin.SMALL: "small",
    Bin.WALL: "wall",
}


class Cause(IntEnum):
    """Why a box is in doubt; of several causes, the one that makes errors likeliest."""

    NONE = 0
    COVERED = 1
    """Kept, but all pixels that match fit into the part that another box covers."""
    OWN_PIXELS = 2
    """Rejected, but more pixels match than another box can have."""
    SOME_PIXELS = 3
    """Rejected, but some pixels match; another box can have them."""
    FEW_PIXELS = 4
    """Rejected, because fewer of its own pixels are seen than the configuration asks
    for."""
    OTHER_KIND = 5
    """Another kind of evidence would decide otherwise."""
    TOSS_UP = 6
    """It has too few pixels to be certain on which side of the threshold it is."""
    UNDECIDED = 7
    """Nothing has decided it."""


class Doubts(NamedTuple):
    """The doubt about N boxes.

    Attributes
    ----------
    doubt : (N,) int16
        1 to 100 for boxes to ask about, the greatest first; else the value of the bin.
    cause : (N,) uint8, `Cause`
        NONE except in the bin ASK.
    against : (N,) uint8
        Where the cause is OTHER_KIND: the kind that would decide otherwise, as its
        position in `KINDS`.
    """

    doubt: NDArray[np.int16]
    cause: NDArray[np.uint8]
    against: NDArray[np.uint8]


KINDS: Final[tuple[EvidenceName, ...]] = (SEMANTIC, *CHANNELS)


_LEAST: Final = 0.1
"""Boxes are asked about if so large a share of boxes like them is wrong."""

_COVERED: Final = 0.5
_ALL_COVERED: Final = 0.9
_OWN_PIXELS: Final = 0.95
_SOME_PIXELS: Final = 0.6
_FEW_PIXELS: Final = 0.9
_TOSS_UP: Final = 0.15
_UNDECIDED: Final = 0.5
"""Shares of such boxes that were decided wrongly. Of those that nothing has decided, a
half is assumed."""

_MOSTLY: Final = 60.0
"""From this crowding on, in percent, matching pixels are as likely the other box's."""

_NEAR_SIDE: Final = 24.0
"""Pixels. Larger boxes are near the camera, so that few others can hide them."""

_SEEN_SIDE: Final = 8.0
"""Pixels. An eye decides about what is at least as large, and less well below."""

_LAST: Final = 0.1
"""What an answer on a box with a shorter side below `_SEEN_SIDE` counts: people hardly
tell such an object from what is around it, so that those boxes come last."""

_OTHERS: Final = 0.8
"""What an answer teaches that is neither about a box near its threshold nor about one
on which kinds of evidence disagree, compared with answers on those."""


class _Disagreement(NamedTuple):
    """The share of boxes wrongly decided by a kind of evidence if another one differs.

    Separately for boxes that were rejected and that were kept.
    """

    decided_by: ChannelName
    other: EvidenceName
    rejected: float
    kept: float


_DISAGREEMENTS: Final = (
    _Disagreement("instance", "depth", 0.9, 0.4),
    _Disagreement("instance", "ordered", 0.2, 0.05),
    _Disagreement("depth", "instance", 0.9, 0.4),
    _Disagreement("ordered", SEMANTIC, 0.3, 0.1),
)
"""Kinds that are not listed add nothing: where depth decides, neither order nor tags
were ever right against it."""


def doubts(evidence: Evidence, config: DecideConfig, decisions: Decisions) -> Doubts:
    """How much an answer on each of N boxes is worth, and why.

    `decisions` are what `decide` gives for this evidence and configuration. Without
    `Evidence.xyxy`, boxes count as squares.
    """
    verdict = VERDICT_OF_REASON.take(decisions.reason)
    count = len(evidence)
    # The share of boxes like each of these that is wrong, and why
    wrong, likely_cause = np.zeros(count), np.zeros(count, np.uint8)
    against = np.zeros(count, np.uint8)

    def raise_share(
        which: BoolArray,
        share: FloatArray | float,
        cause: Cause,
        other: EvidenceName = SEMANTIC,
    ) -> None:
        """Raise the share of these boxes to this one, where it is lower."""
        raised = which & (wrong < share)
        np.copyto(wrong, share, where=raised)
        np.putmask(likely_cause, raised, np.uint8(cause))
        np.putmask(against, raised, np.uint8(KINDS.index(other)))

    is_open = ~IS_FINAL.take(decisions.reason)
    kept, rejected = is_open & (verdict == KEPT), is_open & (verdict == REJECTED)
    # Doubts about boxes that tags decided: pixels may belong to another box
    matches = kept | (rejected & (evidence.matched_pixels > 0))
    rows = np.flatnonzero(matches & (decisions.channel == 0))
    match, crowding = evidence.match_percent[rows], evidence.crowding[rows]
    # NaN, for a match that is not known, fits nowhere.
    fits, is_kept = match <= crowding, kept[rows]
    crowded = np.minimum(crowding / _MOSTLY, 1.0)
    larger = np.maximum(shorter_side(evidence, rows) / _NEAR_SIDE, 1.0)
    covered = _COVERED * crowded / larger
    covered[(crowding >= 99) & (match >= 97)] = _ALL_COVERED
    some = _SOME_PIXELS * (1 - crowded / 2)
    share = np.where(fits, np.where(is_kept, covered, some), _OWN_PIXELS)
    share[is_kept & ~fits] = 0
    wrong[rows] = share
    likely_cause[rows] = np.where(
        fits, np.where(is_kept, Cause.COVERED, Cause.SOME_PIXELS), Cause.OWN_PIXELS
    )
    raise_share(decisions.toss_up, _TOSS_UP, Cause.TOSS_UP)
    undecided = (verdict == UNMEASURED) & (decisions.reason != Reason.PASSED)
    raise_share(undecided, _UNDECIDED, Cause.UNDECIDED)
    if decisions.channel.any():
        number, _ = compared_by_channels(evidence, config, decisions)
        counts_pixels = np.isin(decisions.channel, _PIXEL_CODES)
        few = rejected & counts_pixels & (number > 0)
        raise_share(few, _FEW_PIXELS, Cause.FEW_PIXELS)
        for other, differs, share in _other_kinds(evidence, config, decisions, kept):
            raise_share(differs, share, Cause.OTHER_KIND, other)
    doubt = np.full(len(evidence), Bin.SURE, np.int16)
    rejected = evidence.measured & (verdict == REJECTED)
    doubt[rejected & (evidence.matched_pixels + evidence.unknown_pixels == 0)] = (
        Bin.WALL
    )
    asked = np.flatnonzero(wrong >= _LEAST)
    # (M,): how much answers on the boxes `asked` are worth, from 1 to 100
    boxes, decided = evidence.take(asked), decisions[asked]
    number, needed = compared_by_channels(boxes, config, decided)
    own = np.where(np.isnan(number), boxes.matched_pixels, number)
    side = shorter_side(boxes)
    seen = np.where(own > 0, np.minimum(side, np.sqrt(np.maximum(own, 0))), side)
    teaches = decided.toss_up | (likely_cause[asked] == Cause.OTHER_KIND)
    teaches |= (number >= needed / 2) & (number <= 2 * needed)
    worth = 100 * wrong[asked] * np.minimum(seen / _SEEN_SIDE, 1.0)
    worth *= np.where(teaches, 1.0, _OTHERS)
    worth *= np.where(side < _SEEN_SIDE, _LAST, 1.0)
    rounded: NDArray[np.int16] = np.maximum(np.rint(worth), Bin.ASK).astype(np.int16)
    doubt[asked] = rounded
    doubt[shorter_side(evidence) < config.review_min_side] = Bin.SMALL
    doubt[~_IN_IMAGE.take(decisions.reason)] = Bin.SURE
    cause = np.where(doubt >= Bin.ASK, likely_cause, np.uint8(Cause.NONE))
    return Doubts(doubt, cause, against)


def bins_of(doubt: NDArray[np.int16]) -> NDArray[np.int16]:
    """(N,): the `Bin` of each of N boxes with this doubt."""
    bins: NDArray[np.int16] = np.minimum(doubt, np.int16(Bin.ASK))
    return bins


BIN_NAMED: Final = {member.label: member for member in Bin}
"""The bins by their names on the wire."""


def shorter_side(
    evidence: Evidence, rows: slice | IntArray = slice(None)
) -> FloatArray:
    """(M,) float64, px: the shorter side of some of the boxes (default: all).

    0 for a box without a rectangle.
    """
    if evidence.xyxy is None:
        area = evidence.area_percent[rows] * evidence.image_pixels[rows] / 100
        return np.sqrt(np.maximum(np.nan_to_num(area), 0))
    x0, y0, x1, y1 = evidence.xyxy[rows].T
    side: FloatArray = np.nan_to_num(np.minimum(x1 - x0, y1 - y0))
    return side


def questions(
    doubt: Doubts,
    evidence: Evidence,
    config: DecideConfig,
    decisions: Decisions,
    covering: Mapping[int, str],
) -> list[str | None]:
    """Why each of N boxes is asked about, in one sentence; None for other boxes.

    Parameters
    ----------
    doubt : Doubts
        What `doubts` gives for the next three arguments.
    evidence, config, decisions : of N boxes
    covering : mapping
        The box that covers most of another one, such as "the nearer car 217", by the
        row of that other box. Needed where the cause is COVERED.
    """
    number, needed = compared_by_channels(evidence, config, decisions)
    words: dict[Cause, Callable[[int], str]] = {
        Cause.COVERED: lambda row: (
            f"kept by its tags, but {covering.get(row, 'another box')} covers "
            f"{rounded_percent(float(evidence.crowding[row]))} of it"
        ),
        Cause.OWN_PIXELS: lambda row: (
            f"rejected, but {_pixels(evidence.matched_pixels[row])}, more than another "
            "box can have"
        ),
        Cause.SOME_PIXELS: lambda row: (
            f"rejected, but {_pixels(evidence.matched_pixels[row])}"
        ),
        Cause.FEW_PIXELS: lambda row: (
            f"rejected, but {number[row]:,.0f} of its own pixels can be seen, of the "
            f"{needed[row]:,.0f} that are needed"
        ),
        Cause.OTHER_KIND: lambda row: (
            f"{_NAMES[CHANNELS[decisions.channel[row] - 1]]} and "
            f"{_NAMES[KINDS[doubt.against[row]]]} disagree about it"
        ),
        Cause.TOSS_UP: lambda _: (
            "too few pixels to be certain on which side of the threshold it is"
        ),
        Cause.UNDECIDED: lambda _: "nothing has decided whether it is visible",
    }
    return [
        words[Cause(cause)](row) if cause else None
        for row, cause in enumerate(doubt.cause.tolist())
    ]


def _pixels(matched: np.int64) -> str:
    return f"{matched:,} of its pixels {'matches' if matched == 1 else 'match'}"


_NAMES: Final[Mapping[EvidenceName, str]] = {
    SEMANTIC: "tags",
    "ordered": "order by distance",
    "depth": "depth",
    "depth_center": "depth at the centre",
    "instance": "instances",
    "lidar": "LiDAR",
}


_IN_IMAGE: Final = np.array([False, *(reason.in_image for reason in Reason)])
"""`Reason.in_image` by the number of the reason; there is no reason 0."""


_PIXEL_CODES: Final = [
    1 + CHANNELS.index(name) for name in ("ordered", "depth", "instance")
]
"""The channels that count a box's own pixels, as in `Decisions.channel`."""


def _other_kinds(
    evidence: Evidence, config: DecideConfig, decisions: Decisions, is_kept: BoolArray
) -> Iterator[tuple[EvidenceName, BoolArray, FloatArray]]:
    """Kinds that would decide boxes otherwise than the channel that decided them.

    With each (N,) bool, which boxes these are, and (N,), the share that is wrong.
    """
    has_depth = has_number(evidence, "depth")
    for decided_by, other, if_rejected, if_kept in _DISAGREEMENTS:
        asked = decisions.channel == 1 + CHANNELS.index(decided_by)
        asked &= has_number(evidence, other)
        if other == "ordered":
            asked &= ~has_depth  # which is always right against it
        if not asked.any():
            continue
        # (N,) bool: which of the boxes `rows` a kind of evidence alone would keep
        rows = np.flatnonzero(asked)
        would_keep = np.zeros(len(evidence), np.bool_)
        if other == SEMANTIC:
            by_tags = replace(config, evidence=SEMANTIC)
            reason = decide(evidence.take(rows), by_tags).reason
            would_keep[rows] = reason == Reason.VISIBLE
        else:
            would_keep[rows] = keeps(evidence, config, other)[rows]
        share = np.where(is_kept, if_kept, if_rejected)
        yield other, asked & (is_kept != would_keep), share
