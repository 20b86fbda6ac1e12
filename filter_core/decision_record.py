"""A decision as the product writes it: a plain dict, from plain numbers. No pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from filter_core.classes import accepted_names
from filter_core.config import FilterConfig
from filter_core.explain import HiddenBy, Judgement, explain, hidden_by
from filter_core.types import BoxesXYXY, Decisions, Evidence, FloatArray, Reason


@dataclass(frozen=True)
class FrameFacts:
    """What the decisions of one frame have in common.

    `family` is the segmentation's tag family, None if there was none.
    """

    key: str
    config: FilterConfig
    family: str | None = None
    lossy: bool = False


@dataclass(frozen=True)
class BoxFacts:
    """Plain numbers of one decision, as measured or as stored.

    Percent, pixels and metres; NaN and None both mean "there is none". `tag_counts` are
    the pixels of each tag in the box; `edges` are lines ``x1 y1 x2 y2``.
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
    box_pixels: int
    area_percent: float | None
    crowding: float | None
    distance: float | None
    accept_mask: int
    tag_counts: Sequence[int] | None = None
    xyxy: Sequence[float] | None = None
    amodal_xyxy: Sequence[float] | None = None
    visible_xyxy: Sequence[float] | None = None
    tight_xyxy: Sequence[float] | None = None
    edges: Sequence[Sequence[float]] | None = None
    explained_by: str | None = None


@dataclass(frozen=True)
class FrameGeometry:
    """What only 3D boxes have, for each of N boxes; NaN rows and None elsewhere."""

    amodal_xyxy: BoxesXYXY
    visible_xyxy: BoxesXYXY
    edges: Sequence[FloatArray | None] = field(default_factory=tuple)


def decision_dict(frame: FrameFacts, box: BoxFacts) -> dict[str, Any]:
    """One decision under the keys of the API, ready for JSON.

    What only a server knows (its own ids, run and review) is not there.
    """
    names = accepted_names(box.accept_mask, frame.family) if frame.family else ()
    hiding: list[HiddenBy] = []
    if box.tag_counts is not None and frame.family is not None:
        hiding = hidden_by(box.tag_counts, box.accept_mask, frame.family)
    judgement = _judgement(frame, box, names, hiding)
    return {
        "id": box.id,
        "frame": frame.key,
        "class": box.class_name,
        "verdict": box.reason.verdict.value,
        "reason": box.reason.label,
        "explanation": explain(judgement),
        "evidence": frame.config.evidence if box.measured else None,
        "match_percent": judgement.match_percent,
        "threshold": judgement.threshold,
        "margin": _number(box.margin),
        "toss_up": box.toss_up,
        "large": box.large,
        "matched_pixels": judgement.matched_pixels,
        "box_pixels": box.box_pixels,
        "area_percent": judgement.area_percent,
        "crowding": _number(box.crowding),
        "explained_by": box.explained_by,
        "hidden_by": hiding,
        "lossy": frame.lossy,
        "distance": judgement.distance,
        "xyxy": _rectangle(box.xyxy),
        "amodal_xyxy": _rectangle(box.amodal_xyxy),
        "visible_xyxy": _rectangle(box.visible_xyxy),
        "tight_xyxy": _rectangle(box.tight_xyxy),
        "edges": None if box.edges is None else [list(line) for line in box.edges],
        "config": frame.config.digest,
    }


def decision_dicts(
    frame: FrameFacts | Sequence[FrameFacts],
    ids: Sequence[str],
    evidence: Evidence,
    decisions: Decisions,
    geometry: FrameGeometry | None = None,
) -> list[dict[str, object]]:
    """Decisions in the order of the boxes: of one frame, or each with its own frame."""
    columns = _columns(evidence, decisions)
    rows = (
        dict(zip(columns, row, strict=True))
        for row in zip(*columns.values(), strict=True)
    )
    solid = _geometry_rows(geometry, len(ids))
    frames = [frame] * len(ids) if isinstance(frame, FrameFacts) else frame
    return [
        decision_dict(facts, BoxFacts(box_id, **row, **more))
        for facts, box_id, row, more in zip(frames, ids, rows, solid, strict=True)
    ]


def _columns(evidence: Evidence, decisions: Decisions) -> dict[str, list[Any]]:
    names = evidence.class_names
    columns: dict[str, list[Any]] = {
        "class_name": [names[index] for index in evidence.class_index.tolist()],
        "reason": [Reason(code) for code in decisions.reason.tolist()],
    }
    for name in ("threshold", "margin", "toss_up", "large"):
        columns[name] = getattr(decisions, name).tolist()
    for name in (
        "measured",
        "match_percent",
        "matched_pixels",
        "box_pixels",
        "area_percent",
        "crowding",
        "distance",
        "accept_mask",
    ):
        columns[name] = getattr(evidence, name).tolist()
    for name in ("tag_counts", "xyxy"):
        column = getattr(evidence, name)
        absent: list[Any] = [None] * len(evidence)
        columns[name] = absent if column is None else column.tolist()
    return columns


def _geometry_rows(geometry: FrameGeometry | None, count: int) -> list[dict[str, Any]]:
    if geometry is None:
        return [{} for _ in range(count)]
    return [
        {
            "amodal_xyxy": amodal,
            "visible_xyxy": visible,
            "edges": None if edges is None else np.asarray(edges).tolist(),
        }
        for amodal, visible, edges in zip(
            geometry.amodal_xyxy.tolist(),
            geometry.visible_xyxy.tolist(),
            geometry.edges,
            strict=True,
        )
    ]


def _judgement(
    frame: FrameFacts,
    box: BoxFacts,
    accepted: tuple[str, ...],
    hiding: Sequence[HiddenBy],
) -> Judgement:
    config, name = frame.config, box.class_name
    # A box without a rectangle in the image has no pixels to have a share of.
    match = _number(box.match_percent) if box.box_pixels else None
    return Judgement(
        reason=box.reason,
        class_name=name,
        # The published code's float area can give more than all of a box's pixels.
        match_percent=None if match is None else min(match, 100.0),
        threshold=_number(box.threshold),
        area_percent=_number(box.area_percent),
        large=box.large,
        matched_pixels=box.matched_pixels if box.measured else None,
        min_visible_pixels=int(config.limit_of(name, "min_visible_pixels") or 0),
        distance=_number(box.distance),
        min_distance=config.limit_of(name, "min_distance"),
        max_distance=config.limit_of(name, "max_distance"),
        accepted=accepted,
        hidden_by=hiding,
        published=config.profile == "carlasimu",
    )


def _number(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else value


def _rectangle(xyxy: Sequence[float] | None) -> list[float] | None:
    return None if xyxy is None or math.isnan(xyxy[0]) else list(xyxy)
