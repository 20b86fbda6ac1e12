"""The rules of the channels beside the segmentation, and the sentences about them.

A box is judged by the channel that the configuration names, if that channel has a
number for it; otherwise by the segmentation, as if nothing else were there. Where a
channel judges, its rule replaces the thresholds of the segmentation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from filter_core.config.filter import DecideConfig
from filter_core.config.keys import SEMANTIC
from filter_core.types import BoolArray, ChannelNumbers, Decisions, Evidence, Reason

Codes = NDArray[np.uint8]

_BEFORE_CHANNELS: Final = (
    Reason.OUTSIDE_IMAGE,
    Reason.COVERS_IMAGE,
    Reason.DEGENERATE,
    Reason.OUT_OF_RANGE,
    Reason.UNMAPPED_CLASS,
)
"""Rules that look at no pixel stand before every channel."""

DECIDED_BY_CHANNELS: Final = frozenset(Reason) - {*_BEFORE_CHANNELS}
"""What a channel can have decided."""


def apply_channels(
    evidence: Evidence, config: DecideConfig, decisions: Decisions
) -> None:
    """Judge, in place, the boxes that a channel of the configuration has a number for.

    Parameters
    ----------
    evidence : Evidence of N boxes
    config : DecideConfig
    decisions : Decisions of N boxes
        By the segmentation; what a channel decides has no threshold in percent.
    """
    numbers = evidence.channels
    if numbers is None or config.evidence == SEMANTIC:
        return
    open_ = ~np.isin(decisions.reason, _BEFORE_CHANNELS)
    for name in config.channels:
        rows = np.flatnonzero(open_ & _has_number(numbers, name))
        open_[rows] = False
        reasons = _RULES[name](numbers[rows], config, _needed(evidence, config)[rows])
        decisions.reason[rows] = reasons
        decisions.threshold[rows] = np.nan
        decisions.margin[rows] = np.nan
        decisions.toss_up[rows] = False
        decisions.large[rows] = False


def channels_used(evidence: Evidence, config: DecideConfig) -> list[str]:
    """The channel that each of N boxes is judged by."""
    used = np.full(len(evidence), SEMANTIC, dtype=object)
    if evidence.channels is not None:
        for name in reversed(config.channels):
            used[_has_number(evidence.channels, name)] = name
    return list(used)


def has_number(evidence: Evidence, channel: str) -> BoolArray:
    """(N,) bool: which boxes a channel, or the segmentation, has a number for."""
    if channel == SEMANTIC:
        return evidence.measured
    if evidence.channels is None:
        return np.zeros(len(evidence), np.bool_)
    return _has_number(evidence.channels, channel)


def _has_number(numbers: ChannelNumbers, channel: str) -> BoolArray:
    counts = {
        "ordered": numbers.owned_pixels,
        "depth": numbers.depth_pixels,
        "instance": numbers.instance_pixels,
        "lidar": numbers.lidar_points,
    }
    if channel in counts:
        return np.asarray(counts[channel] >= 0)
    return np.asarray(~np.isnan(numbers.center_gap))


def _needed(evidence: Evidence, config: DecideConfig) -> NDArray[np.int64]:
    limits = config.thresholds_for(evidence.class_names).min_visible_pixels
    return limits[evidence.class_index]


def _by_order(
    numbers: ChannelNumbers, config: DecideConfig, needed: NDArray[np.int64]
) -> Codes:
    """Where nothing nearer explains any pixel, few are as good as many."""
    explained = numbers.explained_by >= 0
    missing = np.where(explained, Reason.EXPLAINED_BY_NEARER, Reason.NO_VISIBLE_PIXELS)
    enough = np.where(explained, config.ordered_min_pixels, np.maximum(needed, 1))
    return _kept_from(numbers.owned_pixels >= enough, missing)


def _by_depth(
    numbers: ChannelNumbers, _: DecideConfig, needed: NDArray[np.int64]
) -> Codes:
    return _kept_from(numbers.depth_pixels >= needed, Reason.HIDDEN_BY_DEPTH)


def _by_center(
    numbers: ChannelNumbers, config: DecideConfig, _: NDArray[np.int64]
) -> Codes:
    return _kept_from(
        numbers.center_gap <= config.depth_tolerance, Reason.HIDDEN_BY_DEPTH
    )


def _by_instance(
    numbers: ChannelNumbers, _: DecideConfig, needed: NDArray[np.int64]
) -> Codes:
    # An instance of no pixels is none, however few are needed.
    seen = numbers.instance_pixels >= np.maximum(needed, 1)
    return _kept_from(seen, Reason.HIDDEN_BY_INSTANCE)


def _by_lidar(
    numbers: ChannelNumbers, config: DecideConfig, _: NDArray[np.int64]
) -> Codes:
    return _kept_from(
        numbers.lidar_points >= config.lidar_min_points, Reason.TOO_FEW_LIDAR_POINTS
    )


def _kept_from(seen: BoolArray, otherwise: Reason | NDArray[np.int64]) -> Codes:
    return np.where(seen, Reason.VISIBLE, otherwise).astype(np.uint8)


_Rule = Callable[[ChannelNumbers, DecideConfig, NDArray[np.int64]], Codes]

_RULES: Final[Mapping[str, _Rule]] = {
    "ordered": _by_order,
    "depth": _by_depth,
    "depth_center": _by_center,
    "instance": _by_instance,
    "lidar": _by_lidar,
}


@dataclass(frozen=True)
class ChannelJudgement:
    """What a sentence about such a box is made of.

    Attributes
    ----------
    channel : a name out of `filter_core.config.keys.CHANNELS`
    kept : bool
    count : int or None
        Pixels or points that speak for the box.
    needed : int
    gap : float or None, metres
        How far what is seen is in front of the box; negative: behind it.
    explained_by : str or None
        The nearer box, as ``car 217``.
    accepted : tuple of str
        Names of the tags that count.
    """

    channel: str
    kept: bool
    count: int | None = None
    needed: int = 1
    gap: float | None = None
    explained_by: str | None = None
    accepted: tuple[str, ...] = ()


def explain_channel(box: ChannelJudgement) -> str:
    """Why a channel kept or rejected a box, without the verdict itself."""
    return _SENTENCES[box.channel](box)


def any_of(names: Sequence[str]) -> str:
    """Names for people: ``Car or Truck``."""
    if len(names) < 2:
        return names[0] if names else "of its class"
    return f"{', '.join(names[:-1])} or {names[-1]}"


def _ordered(box: ChannelJudgement) -> str:
    names, count = any_of(box.accepted), box.count or 0
    if box.kept:
        return f"{_many(count, f'of its {names} pixels')} not explained by nearer boxes"
    if box.explained_by is None:
        return _none_or_few(count, names, box.needed)
    left = f"; {count} of its pixels {_is(count)} left, {box.needed} are needed"
    return f"explained by the nearer {box.explained_by}{left if count else ''}"


def _depth(box: ChannelJudgement) -> str:
    names, count = any_of(box.accepted), box.count or 0
    if box.kept:
        return f"{_many(count, f'of its {names} pixels')} at its own distance"
    if count:
        are = _many(count, f"of its {names} pixels")
        return f"only {are} at its own distance, {box.needed} are needed"
    if box.gap is None:
        return f"none of its pixels are {names}"
    return f"all {names} pixels here are {_apart(box.gap)} the box"


def _center(box: ChannelJudgement) -> str:
    if box.kept or box.gap is None:
        return "nothing nearer than the box is seen at its centre"
    return f"what is seen at its centre is {_apart(box.gap)} the box"


def _instance(box: ChannelJudgement) -> str:
    count = box.count or 0
    if box.kept:
        return f"{_many(count, 'of the pixels of its own instance')} seen"
    if count:
        are = _many(count, "of the pixels of its instance")
        return f"only {are} seen, {box.needed} are needed"
    return "no instance in the image belongs to it"


def _lidar(box: ChannelJudgement) -> str:
    count = box.count or 0
    points = f"LiDAR point{'' if count == 1 else 's'} of {any_of(box.accepted)}"
    lies = "lies" if count == 1 else "lie"
    if box.kept:
        return f"{count:,} {points} {lies} inside it, {box.needed} are needed"
    found = f"only {count:,}" if count else "no"
    return f"{found} {points} {lies} inside it, {box.needed} are needed"


def _none_or_few(count: int, names: str, needed: int) -> str:
    if not count:
        return f"none of its pixels are {names}"
    return f"only {count} of its pixels {_is(count)} {names}, {needed} are needed"


def _many(count: int, of: str) -> str:
    return f"{count:,} {of} {_is(count)}"


def _is(count: int) -> str:
    return "is" if count == 1 else "are"


def _apart(gap: float) -> str:
    where = "nearer than" if gap >= 0 else "behind"
    metres = abs(gap)
    return f"{metres:.0f} m {where}" if metres >= 10 else f"{metres:.1f} m {where}"


_SENTENCES: Final[Mapping[str, Callable[[ChannelJudgement], str]]] = {
    "ordered": _ordered,
    "depth": _depth,
    "depth_center": _center,
    "instance": _instance,
    "lidar": _lidar,
}
