"""Decisions in their output forms: dictionaries for the API, and columns for exports.

`decision_dicts` makes a `Decision` of each box, with the keys of the API, from columns
of evidence and decisions; it reads no pixels. Exports are written from columns:
`decided_boxes` makes those of every format, `decision_columns` those that tables of
decisions have in addition. `occlusion_levels` and `truncation` compute how much of an
object is hidden and cut off, as label formats define it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias, TypedDict, cast

import numpy as np

from filter_core.classes import accepted_names
from filter_core.config.filter import FilterConfig
from filter_core.config.keys import SEMANTIC, EvidenceName
from filter_core.decisions.channel_rules import (
    ChannelJudgement,
    JudgedBy,
    judged_by,
)
from filter_core.decisions.explain import Judgement, explain, hidden_by
from filter_core.decisions.rules import pixels_needed
from filter_core.geometry.projection import BoxGeometry
from filter_core.types import (
    NOT_MEASURED,
    BoolArray,
    BoxesXYXY,
    ChannelNumbers,
    DecidedBoxes,
    DecisionColumns,
    Decisions,
    Evidence,
    FloatArray,
    HiddenBy,
    IntArray,
    Reason,
    ReasonLabel,
    VerdictName,
    counts_or_none,
    floats_or_none,
)

OcclusionLevel: TypeAlias = Literal[0, 1, 2, 3]

FULLY_VISIBLE: Final = 0

PARTLY_OCCLUDED: Final = 1

LARGELY_OCCLUDED: Final = 2

UNKNOWN_OCCLUSION: Final = 3

_PARTLY_FROM: Final = 10.0

_LARGELY_FROM: Final = 50.0
"""Percent of the silhouette. KITTI gives no numbers: its annotators judged by eye."""

Decision = TypedDict(
    "Decision",
    {
        "id": str,
        "frame": str,  # the frame's key
        "class": str,
        "verdict": VerdictName,
        "reason": ReasonLabel,
        "explanation": str,
        "evidence": EvidenceName | None,  # None: nothing was measured
        "match_percent": float | None,
        "threshold": float | None,  # percent
        "margin": float | None,  # percent
        "toss_up": bool,
        "large": bool,
        "matched_pixels": int | None,
        "box_pixels": int | None,
        "area_percent": float | None,
        "crowding": float | None,  # percent
        "explained_by": str | None,  # id of the nearer box that takes its pixels
        "hidden_by": list[HiddenBy],
        "lossy": bool,
        "distance": float | None,  # metres
        "xyxy": list[float] | None,  # px, like the rectangles that follow
        "amodal_xyxy": list[float] | None,
        "visible_xyxy": list[float] | None,
        "tight_xyxy": list[float] | None,
        "visible_pixels": int | None,
        "occluded": OcclusionLevel,
        "truncated": float | None,  # 0..1
        "edges": list[list[float]] | None,  # px, x1 y1 x2 y2 each
        "config": str,  # the configuration's digest
    },
)
"""One box, its verdict and the numbers that led to it, under the keys of the API.

docs/api.md describes each key. The keys that only a server can fill (such as its own
ids, the run and the review) are not in it.
"""


@dataclass(frozen=True)
class FrameFacts:
    """The values that all decisions of one frame share.

    Attributes
    ----------
    key : str
    config : FilterConfig
    family : str or None
        The segmentation's tag family, None if there was none.
    lossy : bool
        The segmentation's colours were not exact.
    names : mapping
        Id and class of boxes, such as ``("217", "car")``, by their position in the
        frame, for decisions that name the nearer box that explains another.
    """

    key: str
    config: FilterConfig
    family: str | None = None
    lossy: bool = False
    names: Mapping[int, tuple[str, str]] = field(default_factory=dict)


def decision_dicts(
    frame: FrameFacts | Sequence[FrameFacts],
    ids: Sequence[str],
    evidence: Evidence,
    decisions: Decisions,
    geometry: BoxGeometry | None = None,
) -> list[Decision]:
    """Decisions in the order of the boxes, ready for JSON.

    Parameters
    ----------
    frame : FrameFacts, or one for each of N boxes
        All frames have the same `config`.
    ids : N str
    evidence : Evidence of N boxes
    decisions : Decisions of N boxes
    geometry : BoxGeometry of N boxes, optional
    """
    count = len(ids)
    if not count:
        return []
    frames = [frame] * count if isinstance(frame, FrameFacts) else frame
    columns = _composed(frames, ids, evidence, decisions, geometry)
    rows = zip(*columns.values(), strict=True)
    return [cast(Decision, dict(zip(columns, row, strict=True))) for row in rows]


def decided_boxes(
    ids: Sequence[str],
    evidence: Evidence,
    decisions: Decisions,
    geometry: BoxGeometry,
    lossy: BoolArray | bool = False,
) -> DecidedBoxes:
    """The columns that labels are written from, without answers of people.

    No sentence is composed and no tag is counted.

    Parameters
    ----------
    ids : sequence of N str
    evidence : Evidence of N boxes
        Without tag counts is enough.
    decisions : Decisions of N boxes
    geometry : BoxGeometry of N boxes
        Its edges are not read.
    lossy : (N,) bool or bool
        Whether their segmentations were lossy images.
    """
    count = len(ids)
    absent = np.full((count, 4), np.nan)
    channels = evidence.channels
    return DecidedBoxes(
        ids=ids,
        class_names=evidence.class_names,
        class_index=evidence.class_index,
        reason=decisions.reason,
        answer=np.zeros(count, np.uint8),
        lossy=np.broadcast_to(lossy, count),
        xyxy=absent if evidence.xyxy is None else evidence.xyxy,
        amodal_xyxy=geometry.amodal_xyxy,
        visible_xyxy=geometry.visible_xyxy,
        tight_xyxy=absent if channels is None else channels.tight_xyxy,
        distance=evidence.distance,
        match_percent=evidence.shown_match(),
        occlusion=np.full(count, UNKNOWN_OCCLUSION)
        if channels is None
        else occlusion_levels(channels.nearer_percent),
    )


def decision_columns(
    frame: FrameFacts | Sequence[FrameFacts], evidence: Evidence, decisions: Decisions
) -> DecisionColumns:
    """The columns of tables of decisions besides `decided_boxes`; no people's answers.

    Parameters
    ----------
    frame : FrameFacts, or one for each of N boxes
        All frames have the same `config`.
    evidence : Evidence of N boxes
    decisions : Decisions of N boxes
    """
    count = len(evidence)
    frames = [frame] * count if isinstance(frame, FrameFacts) else frame
    return DecisionColumns(
        threshold=decisions.threshold,
        margin=decisions.margin,
        toss_up=decisions.toss_up,
        large=decisions.large,
        matched_pixels=_matched_pixels(evidence),
        box_pixels=evidence.box_pixels,
        area_percent=evidence.area_percent,
        crowding=evidence.crowding,
        explained_by=[
            nearer and nearer[0] for nearer in _nearer_boxes(frames, evidence)
        ],
        hidden_by=_tags_in_front(frames, evidence),
        reviewer=[None] * count,
        comment=[None] * count,
        config=frames[0].config.digest if frames else "",
    )


def _composed(
    frames: Sequence[FrameFacts],
    ids: Sequence[str],
    evidence: Evidence,
    decisions: Decisions,
    geometry: BoxGeometry | None,
) -> dict[str, Sequence[object]]:
    """The values of N > 0 decisions for each key of `Decision`, in the keys' order.

    No other code defines the value of a key. (The service replaces `config`.)
    """
    count, config = len(ids), frames[0].config
    channels = evidence.channels
    if channels is None:
        channels = ChannelNumbers.absent(count)
    reasons = [Reason(code) for code in decisions.reason.tolist()]
    hidden, nearer = _tags_in_front(frames, evidence), _nearer_boxes(frames, evidence)
    judged = judged_by(evidence, config, decisions)
    by_channels = _by_channels(frames, evidence, decisions, judged, nearer)
    judgements = _judgements(frames, evidence, decisions, hidden, by_channels)
    amodal, visible, edges = _projected(geometry, count)
    measured = evidence.measured.tolist()
    return {
        "id": ids,
        "frame": [frame.key for frame in frames],
        "class": _class_names(evidence),
        "verdict": [reason.verdict.value for reason in reasons],
        "reason": [reason.label for reason in reasons],
        "explanation": list(map(explain, judgements)),
        "evidence": [
            channel if has_tags or channel != SEMANTIC else None
            for channel, has_tags in zip(judged.channel, measured, strict=True)
        ],
        "match_percent": floats_or_none(evidence.shown_match()),
        "threshold": floats_or_none(decisions.threshold),
        "margin": floats_or_none(decisions.margin),
        "toss_up": decisions.toss_up.tolist(),
        "large": decisions.large.tolist(),
        "matched_pixels": counts_or_none(_matched_pixels(evidence)),
        "box_pixels": evidence.box_pixels.tolist(),
        "area_percent": floats_or_none(evidence.area_percent),
        "crowding": floats_or_none(evidence.crowding),
        "explained_by": [box and box[0] for box in nearer],
        "hidden_by": hidden,
        "lossy": [frame.lossy for frame in frames],
        "distance": floats_or_none(evidence.distance),
        "xyxy": _rectangles(evidence.xyxy, count),
        "amodal_xyxy": amodal,
        "visible_xyxy": visible,
        "tight_xyxy": _rectangles(channels.tight_xyxy, count),
        "visible_pixels": counts_or_none(_visible_pixels(channels)),
        "occluded": occlusion_levels(channels.nearer_percent).tolist(),
        "truncated": list(map(truncation, amodal, visible)),
        "edges": edges,
        "config": [config.digest] * count,
    }


def _judgements(
    frames: Sequence[FrameFacts],
    evidence: Evidence,
    decisions: Decisions,
    hidden: Sequence[list[HiddenBy]],
    by_channels: Sequence[ChannelJudgement | None],
) -> Iterator[Judgement]:
    """The values in the explanations of N > 0 boxes."""
    config, class_names = frames[0].config, _class_names(evidence)
    limits = {name: config.limits_of(name) for name in evidence.class_names}
    masks = evidence.accept_mask.tolist()
    columns: dict[str, Sequence[object]] = {
        "reason": [Reason(code) for code in decisions.reason.tolist()],
        "class_name": class_names,
        "limits": [limits[name] for name in class_names],
        "match_percent": floats_or_none(evidence.shown_match()),
        "threshold": floats_or_none(decisions.threshold),
        "area_percent": floats_or_none(evidence.area_percent),
        "large": decisions.large.tolist(),
        "matched_pixels": evidence.matched_pixels.tolist(),
        "pixels_needed": pixels_needed(evidence, config).tolist(),
        "distance": floats_or_none(evidence.distance),
        "accepted": list(map(_accepted, frames, masks)),
        "hidden_by": hidden,
        "as_carlasimu": [config.profile == "carlasimu"] * len(frames),
        "channel": by_channels,
    }
    rows = zip(*(columns[name] for name in Judgement._fields), strict=True)
    return map(Judgement._make, rows)


def _by_channels(
    frames: Sequence[FrameFacts],
    evidence: Evidence,
    decisions: Decisions,
    judged: JudgedBy,
    nearer: Sequence[tuple[str, str] | None],
) -> list[ChannelJudgement | None]:
    """The judgement of the channels on each of N boxes; None where none judged it."""
    found: list[ChannelJudgement | None] = [None] * len(frames)
    if evidence.channels is None:
        return found
    gaps = floats_or_none(evidence.channels.depth_gap)
    reasons, masks = decisions.reason.tolist(), evidence.accept_mask.tolist()
    numbers, needed = judged.number.tolist(), judged.needed.tolist()
    for row, channel in enumerate(judged.channel):
        if channel != SEMANTIC:
            box = nearer[row]
            found[row] = ChannelJudgement(
                channel=channel,
                kept=reasons[row] == Reason.VISIBLE,
                number=numbers[row],
                needed=needed[row],
                depth_gap=gaps[row],
                nearer=box and f"{box[1]} {box[0]}",
                accepted=_accepted(frames[row], masks[row]),
            )
    return found


def _accepted(frame: FrameFacts, accept_mask: int) -> tuple[str, ...]:
    return accepted_names(accept_mask, frame.family) if frame.family else ()


def _tags_in_front(
    frames: Sequence[FrameFacts], evidence: Evidence
) -> list[list[HiddenBy]]:
    """The tags that hide each of N boxes; none where no tags were counted."""
    if evidence.tag_counts is None:
        return [[] for _ in frames]
    counts, masks = evidence.tag_counts.tolist(), evidence.accept_mask.tolist()
    return [
        [] if frame.family is None else hidden_by(of_tags, mask, frame.family)
        for frame, of_tags, mask in zip(frames, counts, masks, strict=True)
    ]


def _nearer_boxes(
    frames: Sequence[FrameFacts], evidence: Evidence
) -> list[tuple[str, str] | None]:
    """Id and class of the nearer box that explains each of N boxes, if one does."""
    if evidence.channels is None:
        return [None] * len(frames)
    positions = evidence.channels.explained_by.tolist()
    return [
        frame.names.get(position)
        for frame, position in zip(frames, positions, strict=True)
    ]


def _class_names(evidence: Evidence) -> list[str]:
    return [evidence.class_names[index] for index in evidence.class_index.tolist()]


def _matched_pixels(evidence: Evidence) -> IntArray:
    return np.where(evidence.measured, evidence.matched_pixels, NOT_MEASURED)


def _visible_pixels(channels: ChannelNumbers) -> IntArray:
    """(N,): the pixels of a box's instance, else those at its distance."""
    by_instance = channels.instance_pixels != NOT_MEASURED
    return np.where(by_instance, channels.instance_pixels, channels.depth_pixels)


_Rectangles: TypeAlias = list[list[float] | None]


def _projected(
    geometry: BoxGeometry | None, count: int
) -> tuple[_Rectangles, _Rectangles, list[list[list[float]] | None]]:
    """Whole rectangles, those inside the image, and edges of N boxes."""
    if geometry is None:
        return [None] * count, [None] * count, [None] * count
    edges = [
        None if lines is None else np.asarray(lines).tolist()
        for lines in geometry.edges
    ]
    return (
        _rectangles(geometry.amodal_xyxy, count),
        _rectangles(geometry.visible_xyxy, count),
        edges,
    )


def _rectangles(column: BoxesXYXY | None, count: int) -> _Rectangles:
    if column is None:
        return [None] * count
    return [None if row[0] != row[0] else row for row in column.tolist()]


def occlusion_levels(nearer_percent: FloatArray) -> IntArray:
    """KITTI's level of occlusion of N boxes.

    Parameters
    ----------
    nearer_percent : (N,) float64, percent of the silhouette
        The share that something nearer covers; NaN: unknown.

    Returns
    -------
    (N,) int64
        0 fully visible, 1 partly, 2 largely occluded, 3 unknown.

    References
    ----------
    .. [1] A. Geiger, P. Lenz, R. Urtasun, "Are we ready for autonomous driving? The
       KITTI vision benchmark suite", CVPR 2012; readme of the object development kit.
    """
    # Counts the limits that are reached: the levels above 0, in order.
    level = np.digitize(nearer_percent, (_PARTLY_FROM, _LARGELY_FROM))
    return np.where(np.isnan(nearer_percent), UNKNOWN_OCCLUSION, level)


def truncation(
    amodal_xyxy: Sequence[float] | None, visible_xyxy: Sequence[float] | None
) -> float | None:
    """The share of a box's area outside the image, 0..1; None if unknown.

    Both are rectangles in px, before and after clipping to the image; None or NaN
    where there is none.
    """
    if amodal_xyxy is None or math.isnan(amodal_xyxy[0]):
        return None
    whole = _area(amodal_xyxy)
    if visible_xyxy is None or math.isnan(visible_xyxy[0]) or whole <= 0:
        return 1.0
    return min(max(1.0 - _area(visible_xyxy) / whole, 0.0), 1.0)


def _area(xyxy: Sequence[float]) -> float:
    return (xyxy[2] - xyxy[0]) * (xyxy[3] - xyxy[1])
