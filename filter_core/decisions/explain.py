"""The sentence that explains a decision, and the tags that hide a box.

`explain` makes the sentence of one box from the values in an `ExplainedBox`. There is
one for each reason (`_SENTENCES`), or for each channel where a channel decided
(`_CHANNEL_SENTENCES`). `explanations` collects these values for many boxes, from their
evidence and decisions.

`explained_by` and EXPLAINED_BY_NEARER do not mean these sentences, but that the pixels
of a box belong to a nearer one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from filter_core.arrays import UNKNOWN_TAG, floats_or_none
from filter_core.classes import accepted_names, accepts
from filter_core.config.filter import ClassLimits, FilterConfig
from filter_core.decisions.channel_rules import (
    channel_names,
    compared_by_channels,
    pixels_needed,
)
from filter_core.evidence_kinds import ChannelName
from filter_core.evidence_numbers import UNKNOWN_COLUMN, Evidence
from filter_core.segmentation.palettes import FAMILIES
from filter_core.verdicts import Decisions, HiddenBy, Reason, Verdict


class ExplainedBox(NamedTuple):
    """One box with the values that its sentence can name.

    Attributes
    ----------
    limits : ClassLimits
        Of the box's class.
    match_percent, threshold, area_percent : float or None, percent
        Those of `Evidence` and `Decisions`; None: there is none.
    matched_pixels, pixels_needed : int
        The pixels with an accepted tag, and the fewest that keep the box.
    unknown_pixels, box_pixels : int
        The pixels whose tag or colour is not known, and all that count.
    distance : float or None, metres
    distance_range : (low, high) or None, metres
        Between which distances it is, where its distance is not known.
    accepted : tuple of str
        Names of the tags that count.
    hidden_by : sequence of HiddenBy
        See `hidden_by`.
    as_carlasimu : bool
        Whether the match has to exceed the threshold (profile ``carlasimu``) or only
        to reach it (profile ``paper``).
    channel : ChannelName or None
        The channel that decided. None: no channel did; then `number`, `needed`,
        `depth_gap` and `nearer` have no meaning, and the reason is one of `_SENTENCES`.
    number : float
        What the channel compared: pixels, points, or metres.
    needed : float
        The least number that keeps the box; for ``depth_center`` the greatest.
    depth_gap : float or None, metres
        See `ChannelNumbers`.
    nearer : str or None
        The nearer box that takes most of its pixels, as ``car 217``.
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
    unknown_pixels: int = 0
    box_pixels: int = 0
    distance: float | None = None
    distance_range: Sequence[float] | None = None
    accepted: tuple[str, ...] = ()
    hidden_by: Sequence[HiddenBy] = ()
    as_carlasimu: bool = False
    channel: ChannelName | None = None
    number: float = 0
    needed: float = 1
    depth_gap: float | None = None
    nearer: str | None = None


def explain(box: ExplainedBox) -> str:
    """Why a box was kept, rejected or not measured.

    It is the verdict, a colon and the reason. A number is never rounded to the one that
    it is compared with, or past it: 9.96 % is never shown as the 10 % that are needed.
    """
    if box.channel is not None:
        sentence = _CHANNEL_SENTENCES[box.channel](box)
    else:
        sentence = _SENTENCES[box.reason](box)
    return f"{box.reason.verdict.value}: {sentence}"


def _out_of_range(box: ExplainedBox) -> str:
    distance = float("nan") if box.distance is None else box.distance
    nearest, farthest = distance, distance
    if box.distance is None and box.distance_range is not None:
        nearest, farthest = box.distance_range
    low, high = box.limits.min_distance, box.limits.max_distance
    if low is not None and farthest < low:
        limit, words = low, "at least {} m are needed"
    elif high is not None and nearest >= high:
        limit, words = high, "at most {} m are allowed"
    else:
        return "its centre is not far enough ahead of the camera"
    needed = words.format(f"{limit:.15g}")
    if box.distance is None:
        return f"it is {nearest:.15g} to {farthest:.15g} m away, {needed}"
    return f"it is {_rounded(distance, 0, [limit])} m away, {needed}"


def _unmapped(box: ExplainedBox) -> str:
    return f"no tag is accepted for the class {box.class_name!r}"


def _unknown_pixels(box: ExplainedBox) -> str:
    share = 100 * box.unknown_pixels / max(box.box_pixels, 1)
    return (
        f"{rounded_percent(share)} of its pixels have a tag or colour that is not "
        f"known; as {_any_of(box.accepted)} they would keep it"
    )


def _no_visible_pixels(box: ExplainedBox) -> str:
    names = _any_of(box.accepted)
    count, needed = box.matched_pixels, box.pixels_needed
    if count == 0:
        return f"none of its pixels are {names}{_hiding(box)}"
    are = "is" if count == 1 else "are"
    return (
        f"only {count} of its pixels {are} {names}, {needed} are needed{_hiding(box)}"
    )


def _share(box: ExplainedBox) -> str:
    match, threshold = box.match_percent, box.threshold
    if match is None or threshold is None:
        # The match is unknown (NaN), and since no rule rejects such a box, it is kept.
        # This happens only if min_visible_pixels is 0, and no pixel of the box counts:
        # an ignore mask covers it, or it is thinner than a pixel (profile carlasimu).
        return "none of its pixels count"
    large = ""
    if box.large and box.area_percent is not None:
        large = f"it covers {rounded_percent(box.area_percent)} of the image and "
    more = "more than " if box.as_carlasimu else ""
    return (
        f"{large}{rounded_percent(match, threshold)} of its pixels are "
        f"{_any_of(box.accepted)}, {more}{threshold:.15g} % are needed"
    )


def _too_little(box: ExplainedBox) -> str:
    return _share(box) + _hiding(box)


def _hiding(box: ExplainedBox) -> str:
    if not box.hidden_by:
        return ""
    first = box.hidden_by[0]
    return f"; {first['name']} covers {rounded_percent(first['percent'])}"


_SENTENCES: Final[Mapping[Reason, Callable[[ExplainedBox], str]]] = {
    Reason.OUTSIDE_IMAGE: lambda _: "the box lies outside the image",
    Reason.COVERS_IMAGE: lambda _: "the box covers the whole image",
    Reason.DEGENERATE: lambda _: "the box has no area inside the image",
    Reason.OUT_OF_RANGE: _out_of_range,
    Reason.DROPPED_CLASS: _unmapped,
    Reason.UNMAPPED_CLASS: _unmapped,
    Reason.PASSED: lambda box: (
        f"the class map says that {box.class_name!r} is not measured"
    ),
    Reason.UNKNOWN_PIXELS: _unknown_pixels,
    Reason.NO_SEGMENTATION: lambda _: "there is no segmentation to measure with",
    Reason.NO_VISIBLE_PIXELS: _no_visible_pixels,
    Reason.LARGE_BELOW_THRESHOLD: _too_little,
    Reason.BELOW_THRESHOLD: _too_little,
    Reason.VISIBLE: _share,
}
"""The sentence of each reason, except those that only channels give."""


def _ordered_words(box: ExplainedBox) -> str:
    names = _any_of(box.accepted)
    if _is_kept(box):
        belong = "belongs" if box.number == 1 else "belong"
        return f"{box.number:,.0f} of its {names} pixels {belong} to no nearer box"
    if not box.number:
        if box.nearer is None:
            return f"none of its pixels are {names}"
        return f"its {names} pixels belong to nearer boxes, above all {box.nearer}"
    if box.nearer is None:
        pixels_are = f"{box.number:.0f} of its pixels {_is(box)}"
        return f"only {pixels_are} {names}, {_needed(box)}"
    left = f"only {box.number:.0f} of its {names} pixels {_is(box)} left"
    return (
        f"{left}, {_needed(box)}; nearer boxes have the others, above all {box.nearer}"
    )


def _depth_words(box: ExplainedBox) -> str:
    names = _any_of(box.accepted)
    at_its_own = f"{_counted(box, f'of its {names} pixels')} at its own distance"
    if _is_kept(box):
        return at_its_own
    if box.number:
        return f"only {at_its_own}, {_needed(box)}"
    if box.depth_gap is None:
        return f"none of its pixels are {names}"
    return f"all {names} pixels here are {_apart(box.depth_gap)} the box"


def _centre_words(box: ExplainedBox) -> str:
    if _is_kept(box):
        return "nothing nearer than the box is seen at its centre"
    return f"what is seen at its centre is {_apart(box.number)} the box"


def _instance_words(box: ExplainedBox) -> str:
    if _is_kept(box):
        return f"{_counted(box, 'of the pixels of its own instance')} seen"
    if box.number:
        of_instance = _counted(box, "of the pixels of its instance")
        return f"only {of_instance} seen, {_needed(box)}"
    return "no instance in the image belongs to it"


def _lidar_words(box: ExplainedBox) -> str:
    s, lie = ("", "lies") if box.number == 1 else ("s", "lie")
    points = f"LiDAR point{s} of {_any_of(box.accepted)} {lie} inside it"
    if not _is_kept(box) and not box.number:
        return f"no {points}, {_needed(box)}"
    only = "" if _is_kept(box) else "only "
    return f"{only}{box.number:,.0f} {points}, {_needed(box)}"


_CHANNEL_SENTENCES: Final[Mapping[ChannelName, Callable[[ExplainedBox], str]]] = {
    "ordered": _ordered_words,
    "depth": _depth_words,
    "depth_center": _centre_words,
    "instance": _instance_words,
    "lidar": _lidar_words,
}
"""The sentence of each channel, whether it kept the box or rejected it.

What each channel measures: `filter_core.evidence_kinds.EVIDENCE`.
"""


def _is_kept(box: ExplainedBox) -> bool:
    return box.reason.verdict is Verdict.KEPT


def _counted(box: ExplainedBox, of: str) -> str:
    """Number, noun and verb, such as ``3 of its Car pixels are``."""
    return f"{box.number:,.0f} {of} {_is(box)}"


def _is(box: ExplainedBox) -> str:
    return "is" if box.number == 1 else "are"


def _needed(box: ExplainedBox) -> str:
    return f"{box.needed:.0f} {'is' if box.needed == 1 else 'are'} needed"


def _apart(gap: float) -> str:
    where = "nearer than" if gap >= 0 else "behind"
    metres = abs(gap)
    return f"{metres:.0f} m {where}" if metres >= 10 else f"{metres:.1f} m {where}"


def _any_of(names: Sequence[str]) -> str:
    """Names for people: ``Car or Truck``."""
    if len(names) < 2:
        return names[0] if names else "of its class"
    return f"{', '.join(names[:-1])} or {names[-1]}"


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


class BoxName(NamedTuple):
    """Id and class of a box, such as "217" and "car"."""

    box_id: str
    class_name: str


@dataclass(frozen=True)
class FrameFacts:
    """The values that all decisions of one frame share.

    Attributes
    ----------
    family : str or None
        Which of CARLA's tables of tags the segmentation has: a key of `FAMILIES`. None
        if there was no segmentation.
    lossy : bool
        The segmentation's colours were not exact.
    names : mapping
        Id and class of boxes, by their position in the frame, for sentences that name
        the nearer box that takes another's pixels (`ChannelNumbers.explained_by`).
    """

    key: str
    config: FilterConfig
    family: str | None = None
    lossy: bool = False
    names: Mapping[int, BoxName] = field(default_factory=dict)


def explanations(
    frames: Sequence[FrameFacts],
    evidence: Evidence,
    decisions: Decisions,
    hidden: Sequence[Sequence[HiddenBy]],
) -> list[str]:
    """Why each of N > 0 boxes was kept, rejected or not measured: one sentence each.

    There is one of `frames` for each box, all with the same `config`. `decisions` are
    what `decide` gives for `evidence`, `hidden` what `hidden_by_all` does.
    """
    count, config = len(frames), frames[0].config
    limits = [config.limits_of(name) for name in evidence.class_names]
    classes = evidence.class_index.tolist()
    numbers, needed = compared_by_channels(evidence, config, decisions)
    channels, nearer = evidence.channels, nearer_boxes(frames, evidence)
    gaps = [None] * count if channels is None else floats_or_none(channels.depth_gap)
    columns: dict[str, Sequence[object]] = {
        "reason": [Reason(code) for code in decisions.reason.tolist()],
        "class_name": [evidence.class_names[index] for index in classes],
        "limits": [limits[index] for index in classes],
        "match_percent": floats_or_none(evidence.shown_match()),
        "threshold": floats_or_none(decisions.threshold),
        "area_percent": floats_or_none(evidence.area_percent),
        "large": decisions.large.tolist(),
        "matched_pixels": evidence.matched_pixels.tolist(),
        "pixels_needed": pixels_needed(evidence, config).tolist(),
        "unknown_pixels": evidence.unknown_pixels.tolist(),
        "box_pixels": evidence.box_pixels.tolist(),
        "distance": floats_or_none(evidence.distance),
        "distance_range": [None] * count
        if evidence.distance_range is None
        else [
            None if row[0] != row[0] else row
            for row in evidence.distance_range.tolist()
        ],
        "accepted": [
            accepted_names(mask, frame.family) if frame.family else ()
            for frame, mask in zip(frames, evidence.accept_mask.tolist(), strict=True)
        ],
        "hidden_by": hidden,
        "as_carlasimu": [config.profile == "carlasimu"] * count,
        "channel": channel_names(decisions),
        "number": numbers.tolist(),
        "needed": needed.tolist(),
        "depth_gap": gaps,
        "nearer": [box and f"{box.class_name} {box.box_id}" for box in nearer],
    }
    rows = zip(*(columns[name] for name in ExplainedBox._fields), strict=True)
    return list(map(explain, map(ExplainedBox._make, rows)))


def nearer_boxes(
    frames: Sequence[FrameFacts], evidence: Evidence
) -> list[BoxName | None]:
    """Id and class of the nearer box that takes most pixels of each of N boxes.

    None where no box takes any.
    """
    if evidence.channels is None:
        return [None] * len(frames)
    positions = evidence.channels.explained_by.tolist()
    return [
        frame.names.get(position)
        for frame, position in zip(frames, positions, strict=True)
    ]


_HIDES_NOTHING: Final = frozenset(
    {"Road", "RoadLine", "Sidewalk", "Ground", "Terrain", "Sky"}
)
"""Tags of the surroundings of an object, which do not hide it."""

_MOST_SHOWN: Final = 3


def hidden_by_all(
    frames: Sequence[FrameFacts], evidence: Evidence
) -> list[list[HiddenBy]]:
    """`hidden_by` of each of N boxes; nothing where no tags were counted."""
    if evidence.tag_counts is None:
        return [[] for _ in frames]
    counts, masks = evidence.tag_counts.tolist(), evidence.accept_mask.tolist()
    return [
        [] if frame.family is None else hidden_by(of_tags, mask, frame.family)
        for frame, of_tags, mask in zip(frames, counts, masks, strict=True)
    ]


def hidden_by(
    tag_counts: Sequence[int], accept_mask: int, family: str
) -> list[HiddenBy]:
    """The up to three commonest tags in a box that its class does not accept.

    They are taken for what hides it: that they are nearer is not measured. The
    commonest is the first; of equals, the lower tag. `percent` is of all pixels that
    are counted in the box. `HiddenBy.rgb` is white for Unknown. Tags that surround
    objects without hiding them (Road, RoadLine, Sidewalk, Ground, Terrain, Sky) are
    left out. `tag_counts` (N_TAGS,) are the pixels of each tag in the box.
    """
    total = sum(tag_counts)
    hiding = _hiding_tags(accept_mask, family)
    hiding_counts = [
        (count, *hiding[column])
        for column, count in enumerate(tag_counts)
        if count and column in hiding
    ]
    hiding_counts.sort(key=lambda row: (-row[0], row[1]))
    return [
        {"tag": tag, "name": name, "rgb": list(rgb), "percent": 100.0 * count / total}
        for count, tag, name, rgb in hiding_counts[:_MOST_SHOWN]
    ]


_HidingTags: TypeAlias = Mapping[int, tuple[int, str, list[int]]]
"""Tag, name and colour for each column."""


@lru_cache(maxsize=1024)
def _hiding_tags(accept_mask: int, family: str) -> _HidingTags:
    """The columns of a histogram whose pixels hide a box, with the tags they count."""
    palette = FAMILIES[family]
    tags = np.array([*range(UNKNOWN_COLUMN), UNKNOWN_TAG])
    named = [(tag, palette.name_of(tag)) for tag in tags.tolist()]
    accepted = accepts(accept_mask, tags).tolist()
    return {
        column: (tag, name, palette.rgb_table[tag].tolist())
        for column, (tag, name) in enumerate(named)
        if not accepted[column] and name not in _HIDES_NOTHING
    }
