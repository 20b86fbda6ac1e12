"""The rules of the channels, the kinds of evidence besides the segmentation.

A configuration names channels to try in order (`DecideConfig.channels`); the first with
a number for a box judges it, and overwrites what the thresholds of the segmentation
decided. A box that no channel has a number for keeps that decision. `_CHANNELS` has one
row per channel: the number that it judges by, the number that is needed, the reason for
a rejection, and the sentences that explain it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from filter_core.config.filter import DecideConfig
from filter_core.evidence_kinds import SEMANTIC, ChannelName, EvidenceName
from filter_core.types import (
    NOT_MEASURED,
    BoolArray,
    ChannelNumbers,
    Decisions,
    Evidence,
    FloatArray,
    IntArray,
    Reason,
)

_BEFORE_CHANNELS: Final = (
    Reason.OUTSIDE_IMAGE,
    Reason.COVERS_IMAGE,
    Reason.DEGENERATE,
    Reason.OUT_OF_RANGE,
    Reason.UNMAPPED_CLASS,
)
"""Rules that read no pixel: no channel overwrites their decisions."""


def apply_channels(
    evidence: Evidence, config: DecideConfig, decisions: Decisions
) -> None:
    """Overwrite the decisions of the boxes that a channel has a number for.

    Parameters
    ----------
    evidence : Evidence of N boxes
    config : DecideConfig
    decisions : Decisions of N boxes
        As decided by the segmentation; changed in place. What a channel decides has no
        threshold in percent: `threshold` and `margin` become NaN.
    """
    if evidence.channels is None or config.evidence == SEMANTIC:
        return
    boxes = _boxes_to_judge(evidence, evidence.channels, config)
    for name, rows in _rows_of_channels(boxes, decisions):
        decisions.reason[rows] = _CHANNELS[name].reasons(boxes)[rows]
        decisions.threshold[rows] = np.nan
        decisions.margin[rows] = np.nan
        decisions.toss_up[rows] = False
        decisions.large[rows] = False


class JudgedBy(NamedTuple):
    """The channel that judged each of N boxes, and its numbers.

    Attributes
    ----------
    channel : list of N EvidenceName
        The channel, or ``semantic`` where no channel judged the box.
    number, needed : (N,) float64
        What the channel measured and the number that is needed, see `_CHANNELS`; NaN
        for ``semantic``.
    """

    channel: list[EvidenceName]
    number: FloatArray
    needed: FloatArray


def judged_by(
    evidence: Evidence, config: DecideConfig, decisions: Decisions
) -> JudgedBy:
    """The channel that judged each of N boxes, its number and what is needed.

    Parameters
    ----------
    evidence : Evidence of N boxes
    config : DecideConfig
    decisions : Decisions of N boxes
        What `decide` gives for this evidence and configuration.
    """
    count = len(evidence)
    channel = np.full(count, SEMANTIC, dtype=object)
    number, needed = np.full(count, np.nan), np.full(count, np.nan)
    if evidence.channels is not None:
        boxes = _boxes_to_judge(evidence, evidence.channels, config)
        for name, rows in _rows_of_channels(boxes, decisions):
            channel[rows] = name
            number[rows] = _CHANNELS[name].number_of(boxes.numbers)[rows]
            needed[rows] = np.broadcast_to(_CHANNELS[name].needed(boxes), count)[rows]
    return JudgedBy(list(channel), number, needed)


def has_number(evidence: Evidence, channel: EvidenceName) -> BoolArray:
    """(N,) bool: which boxes a channel, or the segmentation, has a number for."""
    if channel == SEMANTIC:
        return evidence.measured
    if evidence.channels is None:
        return np.zeros(len(evidence), np.bool_)
    return _CHANNELS[channel].has_number(evidence.channels)


def _boxes_to_judge(
    evidence: Evidence, numbers: ChannelNumbers, config: DecideConfig
) -> BoxesToJudge:
    needed = config.thresholds_for(evidence.class_names).min_visible_pixels
    return BoxesToJudge(numbers, config, needed[evidence.class_index])


def _rows_of_channels(
    boxes: BoxesToJudge, decisions: Decisions
) -> Iterator[tuple[ChannelName, IntArray]]:
    """Each channel and the rows of the boxes that it judges, none twice.

    Boxes that `decisions` rejects before any channel is asked are in no rows.
    """
    remaining = ~np.isin(decisions.reason, _BEFORE_CHANNELS)
    for name in boxes.config.channels:
        rows = np.flatnonzero(remaining & _CHANNELS[name].has_number(boxes.numbers))
        remaining[rows] = False
        yield name, rows


@dataclass(frozen=True)
class ChannelJudgement:
    """The values in the explanation of a box that a channel judged.

    Attributes
    ----------
    channel : ChannelName
    kept : bool
    number : float
        What the channel judges by: pixels, points, or metres.
    needed : float
        The least that keeps the box; for ``depth_center`` the greatest.
    depth_gap : float or None, metres
        See `ChannelNumbers`.
    nearer : str or None
        The nearer box that explains its pixels, as ``car 217``.
    accepted : tuple of str
        Names of the tags that count.
    """

    channel: ChannelName
    kept: bool
    number: float
    needed: float = 1
    depth_gap: float | None = None
    nearer: str | None = None
    accepted: tuple[str, ...] = ()


def explain_channel(box: ChannelJudgement) -> str:
    """Why a channel kept or rejected a box, without the verdict itself."""
    return _CHANNELS[box.channel].words(box)


def any_of(names: Sequence[str]) -> str:
    """Names for people: ``Car or Truck``."""
    if len(names) < 2:
        return names[0] if names else "of its class"
    return f"{', '.join(names[:-1])} or {names[-1]}"


class BoxesToJudge(NamedTuple):
    """The input of the channels' rules for N boxes.

    Attributes
    ----------
    numbers : ChannelNumbers of N boxes
    config : DecideConfig
    min_visible_pixels : (N,) int64
        The key of that name, as it applies to each box's class.
    """

    numbers: ChannelNumbers
    config: DecideConfig
    min_visible_pixels: IntArray


@dataclass(frozen=True)
class _Channel:
    """The rule of one channel.

    Attributes
    ----------
    number : str
        The column of `ChannelNumbers` that it judges by.
    needed : callable
        The least number that keeps each box, as (N,) or one for all.
    rejected : callable
        The reason of boxes that are not kept, as (N,) or one for all.
    words : callable
        The sentence: why it kept or rejected a box.
    at_most : bool
        `needed` is the greatest number that keeps a box, not the least.
    """

    number: str
    needed: Callable[[BoxesToJudge], IntArray | float]
    rejected: Callable[[BoxesToJudge], IntArray | Reason]
    words: Callable[[ChannelJudgement], str]
    at_most: bool = False

    def number_of(self, numbers: ChannelNumbers) -> FloatArray | IntArray:
        """(N,): what it judges each box by."""
        column: FloatArray | IntArray = getattr(numbers, self.number)
        return column

    def has_number(self, numbers: ChannelNumbers) -> BoolArray:
        """(N,) bool: which boxes it can judge."""
        column = self.number_of(numbers)
        if column.dtype.kind == "f":
            return ~np.isnan(column)
        return np.asarray(column != NOT_MEASURED)

    def reasons(self, boxes: BoxesToJudge) -> NDArray[np.uint8]:
        """(N,) uint8: the `Reason` of each box."""
        number, needed = self.number_of(boxes.numbers), self.needed(boxes)
        kept = number <= needed if self.at_most else number >= needed
        return np.where(kept, Reason.VISIBLE, self.rejected(boxes)).astype(np.uint8)


def _ordered_needed(boxes: BoxesToJudge) -> IntArray:
    # `ordered_min_pixels` only applies where nearer boxes take some pixels.
    explained = boxes.numbers.explained_by != NOT_MEASURED
    least = np.maximum(boxes.min_visible_pixels, 1)
    return np.where(explained, boxes.config.ordered_min_pixels, least)


def _ordered_rejected(boxes: BoxesToJudge) -> IntArray:
    explained = boxes.numbers.explained_by != NOT_MEASURED
    return np.where(explained, Reason.EXPLAINED_BY_NEARER, Reason.NO_VISIBLE_PIXELS)


def _ordered_words(box: ChannelJudgement) -> str:
    names = any_of(box.accepted)
    if box.kept:
        return f"{_many(box, f'of its {names} pixels')} not explained by nearer boxes"
    some = f"{box.number:.0f} of its pixels {_is(box)}"
    if box.nearer is not None:
        left = f"; {some} left, {_needed(box)}" if box.number else ""
        return f"explained by the nearer {box.nearer}{left}"
    if box.number:
        return f"only {some} {names}, {_needed(box)}"
    return f"none of its pixels are {names}"


def _depth_words(box: ChannelJudgement) -> str:
    names = any_of(box.accepted)
    at_its_own = f"{_many(box, f'of its {names} pixels')} at its own distance"
    if box.kept:
        return at_its_own
    if box.number:
        return f"only {at_its_own}, {_needed(box)}"
    if box.depth_gap is None:
        return f"none of its pixels are {names}"
    return f"all {names} pixels here are {_apart(box.depth_gap)} the box"


def _center_words(box: ChannelJudgement) -> str:
    if box.kept:
        return "nothing nearer than the box is seen at its centre"
    return f"what is seen at its centre is {_apart(box.number)} the box"


def _instance_words(box: ChannelJudgement) -> str:
    if box.kept:
        return f"{_many(box, 'of the pixels of its own instance')} seen"
    if box.number:
        return (
            f"only {_many(box, 'of the pixels of its instance')} seen, {_needed(box)}"
        )
    return "no instance in the image belongs to it"


def _lidar_words(box: ChannelJudgement) -> str:
    s, lie = ("", "lies") if box.number == 1 else ("s", "lie")
    points = f"LiDAR point{s} of {any_of(box.accepted)} {lie} inside it"
    if not box.kept and not box.number:
        return f"no {points}, {_needed(box)}"
    only = "" if box.kept else "only "
    return f"{only}{box.number:,.0f} {points}, {_needed(box)}"


def _many(box: ChannelJudgement, of: str) -> str:
    return f"{box.number:,.0f} {of} {_is(box)}"


def _is(box: ChannelJudgement) -> str:
    return "is" if box.number == 1 else "are"


def _needed(box: ChannelJudgement) -> str:
    return f"{box.needed:.0f} are needed"


def _apart(gap: float) -> str:
    where = "nearer than" if gap >= 0 else "behind"
    metres = abs(gap)
    return f"{metres:.0f} m {where}" if metres >= 10 else f"{metres:.1f} m {where}"


_CHANNELS: Final[Mapping[ChannelName, _Channel]] = {
    "ordered": _Channel(
        number="owned_pixels",
        needed=_ordered_needed,
        rejected=_ordered_rejected,
        words=_ordered_words,
    ),
    "depth": _Channel(
        number="depth_pixels",
        needed=lambda boxes: boxes.min_visible_pixels,
        rejected=lambda _: Reason.HIDDEN_BY_DEPTH,
        words=_depth_words,
    ),
    "depth_center": _Channel(
        number="center_gap",
        needed=lambda boxes: boxes.config.depth_tolerance,
        rejected=lambda _: Reason.HIDDEN_BY_DEPTH,
        words=_center_words,
        at_most=True,
    ),
    "instance": _Channel(
        number="instance_pixels",
        # At least 1: 0 pixels mean that no instance was assigned to the box.
        needed=lambda boxes: np.maximum(boxes.min_visible_pixels, 1),
        rejected=lambda _: Reason.HIDDEN_BY_INSTANCE,
        words=_instance_words,
    ),
    "lidar": _Channel(
        number="lidar_points",
        needed=lambda boxes: boxes.config.lidar_min_points,
        rejected=lambda _: Reason.TOO_FEW_LIDAR_POINTS,
        words=_lidar_words,
    ),
}
