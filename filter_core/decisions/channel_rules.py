"""The rules of the channels, the kinds of evidence besides the segmentation.

A configuration names channels to try in order (`DecideConfig.channels`). The first one
with a number for a box decides, and overwrites what the rules of the segmentation
decided, except for the reasons with `Reason.is_final`, such as OUTSIDE_IMAGE and
UNMAPPED_CLASS: these need no pixels. A box that no channel has a number for keeps its
decision. `_CHANNELS` has one row per channel: the number that it compares, the number
that is needed, and the reason of the boxes that it rejects. The sentences of channels
are in `explain`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from filter_core.arrays import NOT_MEASURED, BoolArray, FloatArray, IntArray
from filter_core.config.filter import DecideConfig
from filter_core.evidence_kinds import CHANNELS, SEMANTIC, ChannelName, EvidenceName
from filter_core.evidence_numbers import ChannelNumbers, Evidence
from filter_core.verdicts import Decisions, Reason

IS_FINAL: Final = np.array([False, *(reason.is_final for reason in Reason)])
"""`Reason.is_final` by the number of the reason; there is no reason 0."""


def apply_channels(
    evidence: Evidence, config: DecideConfig, decisions: Decisions
) -> None:
    """Overwrite the decisions of those of N boxes that a channel has a number for.

    `decisions` are those of the segmentation, and are changed in place; one whose
    reason is final (`Reason.is_final`) stays. What a channel decides has no threshold
    in percent: `threshold` and `margin` become NaN.
    """
    numbers = evidence.channels
    if numbers is None or config.evidence == SEMANTIC:
        return
    own_needed = _own_pixels_needed(evidence, config)
    open_to_channels = ~IS_FINAL.take(decisions.reason)
    for name in config.channels:
        rows = np.flatnonzero(open_to_channels & has_number(evidence, name))
        open_to_channels[rows] = False
        channel = _CHANNELS[name]
        kept = channel.keeps(numbers, config, own_needed)
        reasons = np.where(kept, Reason.VISIBLE, channel.rejected(numbers))
        decisions.overwrite(rows, reasons[rows], 1 + CHANNELS.index(name))


def with_more_pixels(
    numbers: ChannelNumbers | None, pixels: IntArray
) -> ChannelNumbers | None:
    """The numbers of channels as if so many more pixels of each box had matched.

    `pixels` is (N,) int64. Numbers that were not measured stay so, and those that count
    no pixels stay as they are.
    """
    if numbers is None:
        return None
    counts = {name: getattr(numbers, name) for name in _PIXEL_COLUMNS}
    return replace(
        numbers,
        **{
            name: np.where(count == NOT_MEASURED, count, count + pixels)
            for name, count in counts.items()
        },
    )


def compared_by_channels(
    evidence: Evidence, config: DecideConfig, decisions: Decisions
) -> tuple[FloatArray, FloatArray]:
    """(N,) float64 each: the number that a channel has of each box, and what it needs.

    As the channel `Decisions.channel` of each box compared them, see `_CHANNELS`; NaN
    where no channel decided. `decisions` are what `decide` gives for `evidence`.
    """
    count = len(evidence)
    number, needed = np.full(count, np.nan), np.full(count, np.nan)
    numbers = evidence.channels
    if numbers is None:
        return number, needed
    own_needed = _own_pixels_needed(evidence, config)
    for code in np.unique(decisions.channel[decisions.channel > 0]).tolist():
        rows, channel = decisions.channel == code, _CHANNELS[CHANNELS[code - 1]]
        number[rows] = channel.number(numbers)[rows]
        limit = channel.needed(numbers, config, own_needed)
        needed[rows] = np.broadcast_to(limit, count)[rows]
    return number, needed


def keeps(evidence: Evidence, config: DecideConfig, channel: ChannelName) -> BoolArray:
    """(N,) bool: which boxes a channel alone would keep, of those it has a number for.

    Raises `ValueError`: no channel was measured.
    """
    if evidence.channels is None:
        raise ValueError(f"expected numbers of {channel}, found no channel's")
    own_needed = _own_pixels_needed(evidence, config)
    return _CHANNELS[channel].keeps(evidence.channels, config, own_needed)


def channel_names(decisions: Decisions) -> list[ChannelName | None]:
    """The channel that decided each of N boxes; None: the rules of the segmentation."""
    names = (None, *CHANNELS)
    return [names[code] for code in decisions.channel.tolist()]


def pixels_needed(evidence: Evidence, config: DecideConfig) -> IntArray:
    """(N,) int64: the key `min_visible_pixels`, as it applies to each of N boxes."""
    by_class = config.limits_by_class(evidence.class_names).min_visible_pixels
    needed: IntArray = by_class[evidence.class_index]
    return needed


def has_number(evidence: Evidence, channel: EvidenceName) -> BoolArray:
    """(N,) bool: which boxes a channel, or the segmentation, has a number for."""
    if channel == SEMANTIC:
        return evidence.measured
    if evidence.channels is None:
        return np.zeros(len(evidence), np.bool_)
    number = _CHANNELS[channel].number(evidence.channels)
    if number.dtype.kind == "f":
        return ~np.isnan(number)
    return np.asarray(number != NOT_MEASURED)


def own_percent(evidence: Evidence, channels: Sequence[ChannelName]) -> FloatArray:
    """(N,) float64, percent: the share of each box's pixels that are its object's own.

    As the first of `channels` that has a number for the box counts them; it is compared
    with `min_visible_percent`. NaN: there is none, or it does not count pixels.
    """
    share: FloatArray = 100 * own_pixels(evidence, channels)
    return share / np.maximum(_pixels_of(evidence), 1)


def own_pixels(evidence: Evidence, channels: Sequence[ChannelName]) -> FloatArray:
    """(N,) float64: the pixels of `own_percent`, compared with `min_visible_pixels`."""
    pixels = np.full(len(evidence), np.nan)
    if evidence.channels is None:
        return pixels
    for name in reversed(channels):
        rows = has_number(evidence, name)
        is_counted = _CHANNELS[name].column in _PIXEL_COLUMNS
        own = _CHANNELS[name].number(evidence.channels)
        pixels[rows] = own[rows] if is_counted else np.nan
    return pixels


def decides(evidence: Evidence, channels: Sequence[ChannelName]) -> BoolArray:
    """(N,) bool: which boxes some channel has a number for."""
    some = np.zeros(len(evidence), np.bool_)
    for name in channels:
        some |= has_number(evidence, name)
    return some


def _pixels_of(evidence: Evidence) -> FloatArray:
    """(N,) float64: the pixels of each box, without ignored ones if it was measured."""
    area = np.nan_to_num(evidence.area_percent * evidence.image_pixels / 100)
    return np.where(evidence.measured, evidence.box_pixels, area)


_PIXEL_COLUMNS: Final = ("owned_pixels", "depth_pixels", "instance_pixels")
"""The fields of `ChannelNumbers` that count pixels of a box."""


_ROUNDING: Final = 1e-9
"""Of a pixel: 10 % of 30 pixels are 3, whatever floating-point numbers say."""


def _own_pixels_needed(evidence: Evidence, config: DecideConfig) -> IntArray:
    """(N,): the fewest pixels of its own that keep each box.

    They are `min_visible_pixels`, and `min_visible_percent` of its pixels.
    """
    limits = config.limits_by_class(evidence.class_names)
    needed = pixels_needed(evidence, config)
    if limits.min_visible_percent.any():
        share = limits.min_visible_percent[evidence.class_index] / 100
        share = share * _pixels_of(evidence)
        needed = np.maximum(needed, np.ceil(share - _ROUNDING).astype(np.int64))
    return needed


@dataclass(frozen=True)
class _Channel:
    """The rule of one channel.

    Attributes
    ----------
    column : str
        The field of `ChannelNumbers` that it compares.
    needed : callable
        The limit of that number, as (N,) or one for all: a box is kept if its number is
        at least this, or with `at_most`, if it is not more. From the numbers of N
        boxes, the configuration and `_own_pixels_needed`.
    rejected : callable
        The reason of boxes that are not kept, as (N,) or one for all.
    """

    column: str
    needed: Callable[[ChannelNumbers, DecideConfig, IntArray], IntArray | float]
    rejected: Callable[[ChannelNumbers], IntArray | Reason]
    at_most: bool = False

    def number(self, numbers: ChannelNumbers) -> FloatArray | IntArray:
        """The number of each box that the rule compares, (N,)."""
        column: FloatArray | IntArray = getattr(numbers, self.column)
        return column

    def keeps(
        self, numbers: ChannelNumbers, config: DecideConfig, own_needed: IntArray
    ) -> BoolArray:
        """(N,) bool: whether the number of each box is one that keeps it."""
        number, needed = self.number(numbers), self.needed(numbers, config, own_needed)
        return np.asarray(number <= needed if self.at_most else number >= needed)


def _ordered_needed(
    numbers: ChannelNumbers, config: DecideConfig, own_needed: IntArray
) -> IntArray:
    # A box that has lost pixels to a nearer one (`filter_core.evidence.ordered`) needs
    # `ordered_min_pixels`, too; all others at least 1.
    least = np.where(_has_lost_pixels(numbers), config.ordered_min_pixels, 1)
    return np.maximum(own_needed, least)


def _ordered_rejected(numbers: ChannelNumbers) -> IntArray:
    return np.where(
        _has_lost_pixels(numbers), Reason.EXPLAINED_BY_NEARER, Reason.NO_VISIBLE_PIXELS
    )


def _has_lost_pixels(numbers: ChannelNumbers) -> BoolArray:
    # The nearer box that takes most of its pixels; `NOT_MEASURED`: none takes any.
    taken_by = numbers.explained_by
    has_lost: BoolArray = taken_by != NOT_MEASURED
    return has_lost


_CHANNELS: Final[Mapping[ChannelName, _Channel]] = {
    "ordered": _Channel(
        column="owned_pixels", needed=_ordered_needed, rejected=_ordered_rejected
    ),
    "depth": _Channel(
        column="depth_pixels",
        needed=lambda _numbers, _config, own_needed: own_needed,
        rejected=lambda _: Reason.HIDDEN_BY_DEPTH,
    ),
    "depth_center": _Channel(
        column="center_gap",
        needed=lambda _numbers, config, _own: config.depth_tolerance,
        rejected=lambda _: Reason.HIDDEN_BY_DEPTH,
        at_most=True,
    ),
    "instance": _Channel(
        column="instance_pixels",
        # At least 1: 0 pixels mean that no instance was assigned to the box.
        needed=lambda _numbers, _config, own_needed: np.maximum(own_needed, 1),
        rejected=lambda _: Reason.HIDDEN_BY_INSTANCE,
    ),
    "lidar": _Channel(
        column="lidar_points",
        needed=lambda _numbers, config, _own: config.lidar_min_points,
        rejected=lambda _: Reason.TOO_FEW_LIDAR_POINTS,
    ),
}
