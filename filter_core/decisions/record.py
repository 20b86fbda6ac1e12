"""Decisions as they are written: dicts as in the API, and columns for exports.

`decision_dicts` makes a `Decision` of each box, under the keys of the API, from columns
of evidence and decisions; it reads no pixels. Exports are written from columns:
`decided_boxes` makes those of every format, `decision_columns` what tables of decisions
have besides them. `occlusion_levels` and `truncation` say how much of an object is
hidden and cut off, in the terms of label formats.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, TypeAlias, TypedDict

import numpy as np

from filter_core.classes import accepted_names
from filter_core.config.filter import FilterConfig
from filter_core.config.keys import SEMANTIC, EvidenceName
from filter_core.decisions.channel_rules import (
    OPEN_TO_CHANNELS,
    ChannelJudgement,
    judged_by,
)
from filter_core.decisions.explain import Judgement, explain, hidden_by
from filter_core.decisions.rules import pixels_needed
from filter_core.geometry.projection import BoxGeometry
from filter_core.types import (
    NOT_MEASURED,
    BoolArray,
    BoxesXYXY,
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
        "explained_by": str | None,  # id of the nearer box that claims its pixels
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

docs/api.md says what each key means. What only a server knows (its own ids, run and
review) is not in it.
"""


@dataclass(frozen=True)
class FrameFacts:
    """What the decisions of one frame have in common.

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
    rows = _box_facts(frame, ids, evidence, decisions, geometry)
    return [_decision(facts, box) for facts, box in rows]


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
        match_percent=_match_percent(evidence),
        occlusion=np.full(count, UNKNOWN_OCCLUSION)
        if channels is None
        else occlusion_levels(channels.nearer_percent),
    )


def decision_columns(
    frame: FrameFacts | Sequence[FrameFacts], evidence: Evidence, decisions: Decisions
) -> DecisionColumns:
    """What tables of decisions have besides `decided_boxes`, without answers of people.

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
        matched_pixels=np.where(
            evidence.measured, evidence.matched_pixels, NOT_MEASURED
        ),
        box_pixels=evidence.box_pixels,
        area_percent=evidence.area_percent,
        crowding=evidence.crowding,
        explained_by=[
            nearer and nearer[0] for nearer in _explaining_boxes(frames, evidence)
        ],
        hidden_by=_hiding_tags(frames, evidence),
        reviewer=[None] * count,
        comment=[None] * count,
        config=frames[0].config.digest if frames else "",
    )


class _BoxFacts(NamedTuple):
    """What a `Decision` is composed from; None: unknown.

    Percent, pixels and metres. `pixels_needed` is what `rules.pixels_needed` gives;
    `channel`, `number` and `needed` are those of `channel_rules.JudgedBy`; `nearer` is
    the id and the class of the box that explains this one.
    """

    id: str
    class_name: str
    reason: Reason
    measured: bool
    match_percent: float | None
    threshold: float | None
    margin: float | None
    toss_up: bool
    large: bool
    matched_pixels: int
    pixels_needed: int
    box_pixels: int
    area_percent: float | None
    crowding: float | None
    distance: float | None
    accept_mask: int
    hidden_by: list[HiddenBy]
    xyxy: list[float] | None
    amodal_xyxy: list[float] | None
    visible_xyxy: list[float] | None
    edges: list[list[float]] | None
    channel: EvidenceName
    number: float
    needed: float
    depth_gap: float | None
    nearer: tuple[str, str] | None
    visible_pixels: int | None
    occluded: OcclusionLevel
    tight_xyxy: list[float] | None


def _box_facts(
    frame: FrameFacts | Sequence[FrameFacts],
    ids: Sequence[str],
    evidence: Evidence,
    decisions: Decisions,
    geometry: BoxGeometry | None,
) -> Iterator[tuple[FrameFacts, _BoxFacts]]:
    """Turn columns into one `_BoxFacts` per box, each with the facts of its frame."""
    if not len(ids):
        return
    frames = [frame] * len(ids) if isinstance(frame, FrameFacts) else frame
    columns: dict[str, Sequence[object]] = {
        "id": ids,
        **_decided(evidence, decisions),
        **_measured(evidence),
        "pixels_needed": pixels_needed(evidence, frames[0].config).tolist(),
        "hidden_by": _hiding_tags(frames, evidence),
        "nearer": _explaining_boxes(frames, evidence),
        **_projected(geometry),
        **_of_channels(evidence, frames[0].config),
    }
    absent = [None] * len(ids)
    rows = zip(*(columns.get(name, absent) for name in _BoxFacts._fields), strict=True)
    yield from zip(frames, map(_BoxFacts._make, rows), strict=True)


def _hiding_tags(
    frames: Sequence[FrameFacts], evidence: Evidence
) -> list[list[HiddenBy]]:
    """What hides each of N boxes; nothing where no tags were counted."""
    if evidence.tag_counts is None:
        return [[] for _ in frames]
    counts, masks = evidence.tag_counts.tolist(), evidence.accept_mask.tolist()
    return [
        [] if frame.family is None else hidden_by(of_tags, mask, frame.family)
        for frame, of_tags, mask in zip(frames, counts, masks, strict=True)
    ]


def _explaining_boxes(
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


def _decided(evidence: Evidence, decisions: Decisions) -> dict[str, Sequence[object]]:
    names = evidence.class_names
    return {
        "class_name": [names[index] for index in evidence.class_index.tolist()],
        "reason": [Reason(code) for code in decisions.reason.tolist()],
        "threshold": floats_or_none(decisions.threshold),
        "margin": floats_or_none(decisions.margin),
        "toss_up": decisions.toss_up.tolist(),
        "large": decisions.large.tolist(),
    }


def _measured(evidence: Evidence) -> dict[str, Sequence[object]]:
    columns: dict[str, Sequence[object]] = {
        "measured": evidence.measured.tolist(),
        "match_percent": floats_or_none(_match_percent(evidence)),
        "matched_pixels": evidence.matched_pixels.tolist(),
        "box_pixels": evidence.box_pixels.tolist(),
        "area_percent": floats_or_none(evidence.area_percent),
        "crowding": floats_or_none(evidence.crowding),
        "distance": floats_or_none(evidence.distance),
        "accept_mask": evidence.accept_mask.tolist(),
    }
    if evidence.xyxy is not None:
        columns["xyxy"] = _rectangles(evidence.xyxy)
    return columns


def _match_percent(evidence: Evidence) -> FloatArray:
    # Under profile carlasimu the match can exceed 100. A box without pixels has no
    # match: the stored 0 is shown as unknown.
    match = np.minimum(evidence.match_percent, 100.0)
    match[evidence.box_pixels == 0] = np.nan
    return match


def _projected(geometry: BoxGeometry | None) -> dict[str, Sequence[object]]:
    if geometry is None:
        return {}
    return {
        "amodal_xyxy": _rectangles(geometry.amodal_xyxy),
        "visible_xyxy": _rectangles(geometry.visible_xyxy),
        "edges": [
            None if lines is None else np.asarray(lines).tolist()
            for lines in geometry.edges
        ],
    }


def _of_channels(
    evidence: Evidence, config: FilterConfig
) -> dict[str, Sequence[object]]:
    numbers = evidence.channels
    if numbers is None:
        count = len(evidence)
        return {
            "channel": [SEMANTIC] * count,
            "occluded": [UNKNOWN_OCCLUSION] * count,
        }
    judged = judged_by(evidence, config)
    by_instance = numbers.instance_pixels != NOT_MEASURED
    visible = np.where(by_instance, numbers.instance_pixels, numbers.depth_pixels)
    return {
        "channel": judged.channel,
        "number": judged.number.tolist(),
        "needed": judged.needed.tolist(),
        "depth_gap": floats_or_none(numbers.depth_gap),
        "visible_pixels": counts_or_none(visible),
        "occluded": occlusion_levels(numbers.nearer_percent).tolist(),
        "tight_xyxy": _rectangles(numbers.tight_xyxy),
    }


def _rectangles(column: BoxesXYXY) -> list[list[float] | None]:
    return [None if row[0] != row[0] else row for row in column.tolist()]


def _decision(frame: FrameFacts, box: _BoxFacts) -> Decision:
    return {
        "id": box.id,
        "frame": frame.key,
        "class": box.class_name,
        "verdict": box.reason.verdict.value,
        "reason": box.reason.label,
        "explanation": explain(_judgement(frame, box)),
        "evidence": box.channel if box.measured or box.channel != SEMANTIC else None,
        "match_percent": box.match_percent,
        "threshold": box.threshold,
        "margin": box.margin,
        "toss_up": box.toss_up,
        "large": box.large,
        "matched_pixels": box.matched_pixels if box.measured else None,
        "box_pixels": box.box_pixels,
        "area_percent": box.area_percent,
        "crowding": box.crowding,
        "explained_by": box.nearer and box.nearer[0],
        "hidden_by": box.hidden_by,
        "lossy": frame.lossy,
        "distance": box.distance,
        "xyxy": box.xyxy,
        "amodal_xyxy": box.amodal_xyxy,
        "visible_xyxy": box.visible_xyxy,
        "tight_xyxy": box.tight_xyxy,
        "visible_pixels": box.visible_pixels,
        "occluded": box.occluded,
        "truncated": truncation(box.amodal_xyxy, box.visible_xyxy),
        "edges": box.edges,
        "config": frame.config.digest,
    }


def _judgement(frame: FrameFacts, box: _BoxFacts) -> Judgement:
    accepted = accepted_names(box.accept_mask, frame.family) if frame.family else ()
    channel = None
    if box.channel != SEMANTIC and box.reason in OPEN_TO_CHANNELS:
        channel = ChannelJudgement(
            channel=box.channel,
            kept=box.reason is Reason.VISIBLE,
            number=box.number,
            needed=box.needed,
            depth_gap=box.depth_gap,
            nearer=box.nearer and f"{box.nearer[1]} {box.nearer[0]}",
            accepted=accepted,
        )
    return Judgement(
        reason=box.reason,
        class_name=box.class_name,
        limits=frame.config.limits_of(box.class_name),
        match_percent=box.match_percent,
        threshold=box.threshold,
        area_percent=box.area_percent,
        large=box.large,
        matched_pixels=box.matched_pixels,
        pixels_needed=box.pixels_needed,
        distance=box.distance,
        accepted=accepted,
        hidden_by=box.hidden_by,
        as_carlasimu=frame.config.profile == "carlasimu",
        channel=channel,
    )


def occlusion_levels(nearer_percent: FloatArray) -> IntArray:
    """KITTI's level of occlusion of N boxes.

    Parameters
    ----------
    nearer_percent : (N,) float64, percent of the silhouette
        What something nearer covers; NaN: unknown.

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
