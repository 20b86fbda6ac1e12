"""The sentence that explains a decision, and the tags that hide a box."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from filter_core.classes import accepts
from filter_core.config.filter import ClassLimits
from filter_core.decisions.channel_rules import (
    ChannelJudgement,
    any_of,
    explain_channel,
)
from filter_core.segmentation.palettes import FAMILIES
from filter_core.types import UNKNOWN_COLUMN, UNKNOWN_TAG, HiddenBy, Reason

_HIDES_NOTHING: Final = frozenset(
    {"Road", "RoadLine", "Sidewalk", "Ground", "Terrain", "Sky"}
)
"""Tags of the surroundings of an object, which do not hide it."""

_MOST_SHOWN: Final = 3


class Judgement(NamedTuple):
    """The values in the explanation of one box.

    Attributes
    ----------
    reason : Reason
    class_name : str
    limits : ClassLimits
        Of the box's class.
    match_percent, threshold, area_percent : float or None, percent
        Those of `Evidence` and `Decisions`; None: there is none.
    large : bool
    matched_pixels, pixels_needed : int
        The pixels with an accepted tag, and the fewest that keep the box.
    distance : float or None, metres
    accepted : tuple of str
        Names of the tags that count.
    hidden_by : sequence of HiddenBy
        See `hidden_by`.
    as_carlasimu : bool
        Whether the match has to exceed the threshold (profile ``carlasimu``) or only
        to reach it (profile ``paper``).
    channel : ChannelJudgement or None
        The judgement of a channel; None if no channel judged the box. The reasons of
        channels have no sentence without it.
    """

    reason: Reason
    class_name: str
    limits: ClassLimits = ClassLimits()
    match_percent: float | None = None
    threshold: float | None = None
    area_percent: float | None = None
    large: bool = False
    matched_pixels: int = 0
    pixels_needed: int = 1
    distance: float | None = None
    accepted: tuple[str, ...] = ()
    hidden_by: Sequence[HiddenBy] = ()
    as_carlasimu: bool = False
    channel: ChannelJudgement | None = None


def hidden_by(
    tag_counts: Sequence[int], accept_mask: int, family: str
) -> list[HiddenBy]:
    """The up to three commonest tags in a box that its class does not accept.

    Parameters
    ----------
    tag_counts : (N_TAGS,) pixels of each tag in the box; the last column is Unknown
    accept_mask : bit t is set if the class accepts tag t
    family : a key of `filter_core.segmentation.palettes.FAMILIES`

    Returns
    -------
    list of {"tag", "name", "percent"}, the commonest first (ties: the lower tag)
        Percent of all counted pixels. Tags that surround objects without hiding them
        (Road, RoadLine, Sidewalk, Ground, Terrain, Sky) are left out.
    """
    total = sum(tag_counts)
    hiding = _hiding_tags(accept_mask, family)
    found = [
        (-count, *hiding[column])
        for column, count in enumerate(tag_counts)
        if count and column in hiding
    ]
    return [
        {"tag": tag, "name": name, "percent": 100.0 * -negative / total}
        for negative, tag, name in sorted(found)[:_MOST_SHOWN]
    ]


@lru_cache(maxsize=1024)
def _hiding_tags(accept_mask: int, family: str) -> Mapping[int, tuple[int, str]]:
    """The columns of a histogram whose pixels hide a box: to each its tag and name."""
    palette = FAMILIES[family]
    tags = np.array([*range(UNKNOWN_COLUMN), UNKNOWN_TAG])
    named = [(tag, palette.name_of(tag)) for tag in tags.tolist()]
    accepted = accepts(accept_mask, tags).tolist()
    return {
        column: (tag, name)
        for column, (tag, name) in enumerate(named)
        if not accepted[column] and name not in _HIDES_NOTHING
    }


def explain(judgement: Judgement) -> str:
    """Why a box was kept, rejected or not measured, in one sentence.

    Parameters
    ----------
    judgement : Judgement

    Returns
    -------
    str
        The verdict, a colon and the reason. A number is never rounded to the one that
        it is compared with, or past it: 9.96 % is never shown as the 10 % that are
        needed.
    """
    if judgement.channel is not None:
        sentence = explain_channel(judgement.channel)
    else:
        sentence = _SENTENCES[judgement.reason](judgement)
    return f"{judgement.reason.verdict.value}: {sentence}"


def rounded_percent(value: float, against: float | None = None) -> str:
    """A percentage, 0..100, for people, never rounded to `against` or past it.

    A whole number from 10 up, one decimal below. It has more decimals if rounding would
    move it to, or past, `against`, 0 or 100.
    """
    marks = [0.0, 100.0] + ([against] if against is not None else [])
    return f"{_rounded(value, 0 if value >= 10 else 1, marks)} %"


def _rounded(value: float, digits: int, marks: Sequence[float]) -> str:
    """With the fewest decimals that keep the value on its side of every mark."""
    shown = value
    for count in range(digits, 10):
        text = f"{value:.{count}f}"
        shown = float(text)
        if _keeps_sides(value, shown, marks):
            break
    return text.rstrip("0").rstrip(".") if "." in text else text


def _keeps_sides(value: float, shown: float, marks: Sequence[float]) -> bool:
    if value == shown:
        return True
    # A loop, because `all` of a generator is slower than the rest of the sentence.
    for mark in marks:
        if (value > mark) != (shown > mark) or (value < mark) != (shown < mark):
            return False
    return True


def _exact_percent(value: float) -> str:
    return f"{value:.15g} %"


def _metres(value: float, limit: float) -> str:
    return f"{_rounded(value, 0, [limit])} m"


def _outside(_: Judgement) -> str:
    return "the box lies outside the image"


def _covers(_: Judgement) -> str:
    return "the box covers the whole image"


def _degenerate(_: Judgement) -> str:
    return "the box has no area inside the image"


def _out_of_range(box: Judgement) -> str:
    distance = box.distance if box.distance is not None else float("nan")
    low, high = box.limits.min_distance, box.limits.max_distance
    if low is not None and distance < low:
        limit, words = low, "at least"
    elif high is not None and distance > high:
        limit, words = high, "at most"
    else:
        return "it is not in the range of distances that is wanted"
    return f"it is {_metres(distance, limit)} away, {words} {limit:.15g} m are wanted"


def _unmapped(box: Judgement) -> str:
    return f"no tag is accepted for the class {box.class_name!r}"


def _unmeasured(_: Judgement) -> str:
    return "there is no segmentation to measure with"


def _no_visible_pixels(box: Judgement) -> str:
    names = any_of(box.accepted)
    found, needed = box.matched_pixels, box.pixels_needed
    if found == 0:
        return f"none of its pixels are {names}{_hiding(box)}"
    are = "is" if found == 1 else "are"
    return (
        f"only {found} of its pixels {are} {names}, {needed} are needed{_hiding(box)}"
    )


def _share(box: Judgement) -> str:
    match, threshold = box.match_percent, box.threshold
    if match is None or threshold is None:
        return f"some of its pixels are {any_of(box.accepted)}"
    large = ""
    if box.large and box.area_percent is not None:
        large = f"it covers {rounded_percent(box.area_percent)} of the image and "
    more = "more than " if box.as_carlasimu else ""
    return (
        f"{large}{rounded_percent(match, threshold)} of its pixels are "
        f"{any_of(box.accepted)}, {more}{_exact_percent(threshold)} are needed"
    )


def _too_little(box: Judgement) -> str:
    return _share(box) + _hiding(box)


def _hiding(box: Judgement) -> str:
    if not box.hidden_by:
        return ""
    first = box.hidden_by[0]
    return f"; {first['name']} covers {rounded_percent(first['percent'])}"


_SENTENCES: Final[Mapping[Reason, Callable[[Judgement], str]]] = {
    Reason.OUTSIDE_IMAGE: _outside,
    Reason.COVERS_IMAGE: _covers,
    Reason.DEGENERATE: _degenerate,
    Reason.OUT_OF_RANGE: _out_of_range,
    Reason.UNMAPPED_CLASS: _unmapped,
    Reason.NO_SEGMENTATION: _unmeasured,
    Reason.NO_VISIBLE_PIXELS: _no_visible_pixels,
    Reason.LARGE_BELOW_THRESHOLD: _too_little,
    Reason.BELOW_THRESHOLD: _too_little,
    Reason.VISIBLE: _share,
}
