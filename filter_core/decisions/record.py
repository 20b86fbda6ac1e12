"""Decisions in their output forms: dictionaries for the API, and columns for exports.

`decision_dicts` makes a `Decision` of each box, with the keys of the API, from columns
of evidence and decisions; it reads no pixels. Exports are written from columns:
`decided_boxes` makes those of every format, `decision_columns` those that tables of
decisions have in addition. `occlusion_levels` and `truncation` compute how much of an
object is hidden and cut off, as label formats define it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Literal, TypeAlias, TypedDict, cast

import numpy as np

from filter_core.arrays import (
    NOT_MEASURED,
    BoolArray,
    BoxesXYXY,
    FloatArray,
    IntArray,
    counts_or_none,
    floats_or_none,
)
from filter_core.decisions.channel_rules import channel_names
from filter_core.decisions.explain import (
    FrameFacts,
    explanations,
    hidden_by_all,
    nearer_boxes,
)
from filter_core.evidence_kinds import SEMANTIC, EvidenceName
from filter_core.evidence_numbers import ChannelNumbers, Evidence
from filter_core.geometry.projection import BoxGeometry
from filter_core.verdicts import (
    DecidedBoxes,
    DecisionColumns,
    Decisions,
    HiddenBy,
    Reason,
    ReasonLabel,
    VerdictName,
)

OcclusionLevel: TypeAlias = Literal[0, 1, 2, 3]

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
        "unknown_pixels": int | None,
        "area_percent": float | None,
        "crowding": float | None,  # percent
        "explained_by": str | None,  # id of the nearer box that takes most pixels
        "hidden_by": list[HiddenBy],
        "lossy": bool,
        "distance": float | None,  # metres
        "distance_range": list[float] | None,  # metres; where no distance is known
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

    Notes
    -----
    The service replaces `config`. The history of a box (`app/review/history.py`) has
    four of these keys, with the same values; no other code defines one of them.
    """
    count = len(ids)
    if not count:
        return []
    frames = [frame] * count if isinstance(frame, FrameFacts) else frame
    channels = evidence.channels
    if channels is None:
        channels = ChannelNumbers.absent(count)
    reasons = [Reason(code) for code in decisions.reason.tolist()]
    hidden, nearer = hidden_by_all(frames, evidence), nearer_boxes(frames, evidence)
    # Whole rectangles, those inside the image, and edges
    amodal = _rectangles(geometry.amodal_xyxy if geometry is not None else None, count)
    visible = _rectangles(
        geometry.visible_xyxy if geometry is not None else None, count
    )
    lines = geometry.edges if geometry is not None else [None] * count
    edges = [
        None if box_edges is None else np.asarray(box_edges).tolist()
        for box_edges in lines
    ]
    measured = evidence.measured.tolist()
    # (N,): the pixels of a box's instance, else those at its distance
    by_instance = channels.instance_pixels != NOT_MEASURED
    columns: dict[str, Sequence[object]] = {
        "id": ids,
        "frame": [frame.key for frame in frames],
        "class": [
            evidence.class_names[index] for index in evidence.class_index.tolist()
        ],
        "verdict": [reason.verdict.value for reason in reasons],
        "reason": [reason.label for reason in reasons],
        "explanation": explanations(frames, evidence, decisions, hidden),
        # The kind of evidence that decided, as the key `evidence` names it.
        "evidence": [
            channel or (SEMANTIC if has_tags else None)
            for channel, has_tags in zip(
                channel_names(decisions), measured, strict=True
            )
        ],
        "match_percent": floats_or_none(evidence.shown_match()),
        "threshold": floats_or_none(decisions.threshold),
        "margin": floats_or_none(decisions.margin),
        "toss_up": decisions.toss_up.tolist(),
        "large": decisions.large.tolist(),
        "matched_pixels": counts_or_none(_counted(evidence.matched_pixels, evidence)),
        "box_pixels": evidence.box_pixels.tolist(),
        "unknown_pixels": counts_or_none(_counted(evidence.unknown_pixels, evidence)),
        "area_percent": floats_or_none(evidence.area_percent),
        "crowding": floats_or_none(evidence.crowding),
        "explained_by": [box and box.box_id for box in nearer],
        "hidden_by": hidden,
        "lossy": [frame.lossy for frame in frames],
        "distance": floats_or_none(evidence.distance),
        "distance_range": _rectangles(evidence.distance_range, count),
        "xyxy": _rectangles(evidence.xyxy, count),
        "amodal_xyxy": amodal,
        "visible_xyxy": visible,
        "tight_xyxy": _rectangles(channels.tight_xyxy, count),
        "visible_pixels": counts_or_none(
            np.where(by_instance, channels.instance_pixels, channels.depth_pixels)
        ),
        "occluded": occlusion_levels(channels.nearer_percent).tolist(),
        "truncated": list(map(truncation, amodal, visible)),
        "edges": edges,
        "config": [frames[0].config.digest] * count,
    }
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
        distance_range=np.full((count, 2), np.nan)
        if evidence.distance_range is None
        else evidence.distance_range,
        match_percent=evidence.shown_match(),
        occlusion=np.full(count, UNKNOWN_OCCLUSION)
        if channels is None
        else occlusion_levels(channels.nearer_percent),
    )


def decision_columns(
    frame: FrameFacts | Sequence[FrameFacts], evidence: Evidence, decisions: Decisions
) -> DecisionColumns:
    """The columns of tables of N decisions besides `decided_boxes`.

    People's answers are not among them. `frame` is one for all boxes, or one for each;
    all frames have the same `config`.
    """
    count = len(evidence)
    frames = [frame] * count if isinstance(frame, FrameFacts) else frame
    return DecisionColumns(
        threshold=decisions.threshold,
        margin=decisions.margin,
        toss_up=decisions.toss_up,
        large=decisions.large,
        matched_pixels=_counted(evidence.matched_pixels, evidence),
        box_pixels=evidence.box_pixels,
        unknown_pixels=_counted(evidence.unknown_pixels, evidence),
        area_percent=evidence.area_percent,
        crowding=evidence.crowding,
        explained_by=[
            nearer and nearer.box_id for nearer in nearer_boxes(frames, evidence)
        ],
        hidden_by=hidden_by_all(frames, evidence),
        reviewer=[None] * count,
        comment=[None] * count,
        config=frames[0].config.digest if frames else "",
    )


def _counted(pixels: IntArray, evidence: Evidence) -> IntArray:
    """(N,): counts of pixels, `NOT_MEASURED` where there was no segmentation."""
    return np.where(evidence.measured, pixels, NOT_MEASURED)


_Rectangles: TypeAlias = list[list[float] | None]


def _rectangles(column: BoxesXYXY | None, count: int) -> _Rectangles:
    if column is None:
        return [None] * count
    return [None if row[0] != row[0] else row for row in column.tolist()]


def occlusion_levels(nearer_percent: FloatArray) -> IntArray:
    """(N,) int64: KITTI's level of occlusion of N boxes.

    0 fully visible, 1 partly, 2 largely occluded, 3 unknown. `nearer_percent`, (N,)
    float64, is the share of the silhouette that something nearer covers; NaN: unknown.

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
