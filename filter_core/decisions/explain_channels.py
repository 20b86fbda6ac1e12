"""Sentences about boxes that were judged by a channel beside the segmentation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class ChannelJudgement:
    """What a sentence about such a box is made of.

    Attributes
    ----------
    channel : a name out of `filter_core.channel_types.CHANNELS`
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
