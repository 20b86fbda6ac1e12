"""A decision as it is written: a plain dict under the keys of the API.

Plain numbers come in, as measured or as stored, and no pixels. Beside verdict and
explanation a decision says how much of its object is hidden and cut off, in the words
of label formats.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from filter_core.classes import accepted_names
from filter_core.config.filter import FilterConfig
from filter_core.config.keys import SEMANTIC
from filter_core.decisions.channels import (
    DECIDED_BY_CHANNELS,
    ChannelJudgement,
    channels_used,
)
from filter_core.decisions.explain import HiddenBy, Judgement, explain, hidden_by
from filter_core.geometry.projection import BoxGeometry
from filter_core.types import NOT_MEASURED, Decisions, Evidence, Reason

FULLY_VISIBLE: Final = 0

PARTLY_OCCLUDED: Final = 1

LARGELY_OCCLUDED: Final = 2

UNKNOWN_OCCLUSION: Final = 3

_PARTLY_FROM: Final = 10.0

_LARGELY_FROM: Final = 50.0
"""Percent of the silhouette; KITTI's annotators judged by eye."""


def occlusion_level(nearer_percent: float | None) -> int:
    """KITTI's level of occlusion.

    Parameters
    ----------
    nearer_percent : float or None, percent of the silhouette
        What something nearer covers; None or NaN: unknown.

    Returns
    -------
    int
        0 fully visible, 1 partly, 2 largely occluded, 3 unknown.

    References
    ----------
    .. [1] A. Geiger, P. Lenz, R. Urtasun, "Are we ready for autonomous driving? The
       KITTI vision benchmark suite", CVPR 2012; readme of the object development kit.
    """
    if nearer_percent is None or math.isnan(nearer_percent):
        return UNKNOWN_OCCLUSION
    if nearer_percent >= _LARGELY_FROM:
        return LARGELY_OCCLUDED
    return PARTLY_OCCLUDED if nearer_percent >= _PARTLY_FROM else FULLY_VISIBLE


def truncation(
    amodal_xyxy: Sequence[float] | None, visible_xyxy: Sequence[float] | None
) -> float | None:
    """Which share of a box lies outside the image, 0..1; None where it is unknown."""
    if amodal_xyxy is None or math.isnan(amodal_xyxy[0]):
        return None
    whole = _area(amodal_xyxy)
    if visible_xyxy is None or math.isnan(visible_xyxy[0]) or whole <= 0:
        return 1.0
    return min(max(1.0 - _area(visible_xyxy) / whole, 0.0), 1.0)


def _area(xyxy: Sequence[float]) -> float:
    return (xyxy[2] - xyxy[0]) * (xyxy[3] - xyxy[1])


@dataclass(frozen=True)
class FrameFacts:
    """What the decisions of one frame have in common.

    `family` is the segmentation's tag family, None if there was none. `names` are the
    boxes that others can be explained by, such as ``(217, car)`` by their position in
    the frame: id and class.
    """

    key: str
    config: FilterConfig
    family: str | None = None
    lossy: bool = False
    names: Mapping[int, tuple[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class ChannelFacts:
    """Plain numbers of one box beside the segmentation's; None: there is none.

    `used` is the channel that decided; see `ChannelNumbers` for the others.
    """

    used: str = SEMANTIC
    owned_pixels: int | None = None
    explained_by: int | None = None
    depth_pixels: int | None = None
    nearer_percent: float | None = None
    depth_gap: float | None = None
    center_gap: float | None = None
    instance_pixels: int | None = None
    lidar_points: int | None = None
    tight_xyxy: Sequence[float] | None = None

    @property
    def visible_pixels(self) -> int | None:
        """Pixels that are known to be the box's own."""
        if self.instance_pixels is not None:
            return self.instance_pixels
        return self.depth_pixels


_NO_CHANNEL: Final = ChannelFacts()


class BoxFacts(NamedTuple):
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
    edges: Sequence[Sequence[float]] | None = None
    channel: ChannelFacts = _NO_CHANNEL


def decision_dict(frame: FrameFacts, box: BoxFacts) -> dict[str, Any]:
    """One decision under the keys of the API, ready for JSON.

    What only a server knows (its own ids, run and review) is not there.
    """
    names = accepted_names(box.accept_mask, frame.family) if frame.family else ()
    hiding: list[HiddenBy] = []
    if box.tag_counts is not None and frame.family is not None:
        hiding = hidden_by(box.tag_counts, box.accept_mask, frame.family)
    judgement = _judgement(frame, box, names, hiding)
    explained_by = frame.names.get(_position(box.channel.explained_by))
    return {
        "id": box.id,
        "frame": frame.key,
        "class": box.class_name,
        "verdict": box.reason.verdict.value,
        "reason": box.reason.label,
        "explanation": explain(judgement),
        "evidence": _channel_used(box),
        "match_percent": judgement.match_percent,
        "threshold": judgement.threshold,
        "margin": _number(box.margin),
        "toss_up": box.toss_up,
        "large": box.large,
        "matched_pixels": judgement.matched_pixels,
        "box_pixels": box.box_pixels,
        "area_percent": judgement.area_percent,
        "crowding": _number(box.crowding),
        "explained_by": explained_by[0] if explained_by else None,
        "hidden_by": hiding,
        "lossy": frame.lossy,
        "distance": judgement.distance,
        "xyxy": _rectangle(box.xyxy),
        "amodal_xyxy": _rectangle(box.amodal_xyxy),
        "visible_xyxy": _rectangle(box.visible_xyxy),
        "tight_xyxy": _rectangle(box.channel.tight_xyxy),
        "visible_pixels": box.channel.visible_pixels,
        "occluded": occlusion_level(box.channel.nearer_percent),
        "truncated": truncation(box.amodal_xyxy, box.visible_xyxy),
        "edges": None if box.edges is None else [list(line) for line in box.edges],
        "config": frame.config.digest,
    }


def decision_dicts(
    frame: FrameFacts | Sequence[FrameFacts],
    ids: Sequence[str],
    evidence: Evidence,
    decisions: Decisions,
    geometry: BoxGeometry | None = None,
) -> list[dict[str, object]]:
    """Decisions in the order of the boxes: of one frame, or each with its own frame.

    All frames have the same configuration.
    """
    rows = _box_facts(frame, ids, evidence, decisions, geometry)
    return [decision_dict(facts, box) for facts, box in rows]


def label_dicts(
    frame: FrameFacts | Sequence[FrameFacts],
    ids: Sequence[str],
    evidence: Evidence,
    decisions: Decisions,
    geometry: BoxGeometry | None = None,
) -> list[dict[str, object]]:
    """`decision_dicts` with the few keys that formats of labels write.

    No sentence is composed and no tag is counted, so `evidence` needs no tag counts,
    `geometry` no edges and `frame` no names.
    """
    rows = _box_facts(frame, ids, evidence, decisions, geometry)
    return [
        {
            "id": box.id,
            "class": box.class_name,
            "verdict": box.reason.verdict.value,
            "reason": box.reason.label,
            "match_percent": _match_percent(box),
            "lossy": facts.lossy,
            "distance": _number(box.distance),
            "xyxy": _rectangle(box.xyxy),
            "amodal_xyxy": _rectangle(box.amodal_xyxy),
            "visible_xyxy": _rectangle(box.visible_xyxy),
            "tight_xyxy": _rectangle(box.channel.tight_xyxy),
            "occluded": occlusion_level(box.channel.nearer_percent),
        }
        for facts, box in rows
    ]


def _box_facts(
    frame: FrameFacts | Sequence[FrameFacts],
    ids: Sequence[str],
    evidence: Evidence,
    decisions: Decisions,
    geometry: BoxGeometry | None,
) -> Iterator[tuple[FrameFacts, BoxFacts]]:
    """Columns of many boxes as one row for each, beside what its frame has."""
    if not len(ids):
        return
    frames = [frame] * len(ids) if isinstance(frame, FrameFacts) else frame
    columns: dict[str, Sequence[Any]] = {
        "id": ids,
        **_columns(evidence, decisions),
        **_geometry_columns(geometry),
        "channel": _channel_facts(evidence, frames[0].config),
    }
    missing = BoxFacts._field_defaults
    rows = zip(
        *(columns.get(name) or [missing[name]] * len(ids) for name in BoxFacts._fields),
        strict=True,
    )
    yield from zip(frames, map(BoxFacts._make, rows), strict=True)


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


def _channel_facts(evidence: Evidence, config: FilterConfig) -> list[ChannelFacts]:
    numbers = evidence.channels
    if numbers is None:
        return [_NO_CHANNEL] * len(evidence)
    names = [spec.name for spec in fields(numbers)]
    columns = [_plain(getattr(numbers, name)) for name in names]
    return [
        ChannelFacts(used, **dict(zip(names, row, strict=True)))
        for used, *row in zip(channels_used(evidence, config), *columns, strict=True)
    ]


def _plain(column: NDArray[Any]) -> list[Any]:
    """None where nothing was measured."""
    if column.ndim == 2:
        return [None if math.isnan(row[0]) else row for row in column.tolist()]
    if column.dtype.kind == "f":
        return [_number(value) for value in column.tolist()]
    return [None if value == NOT_MEASURED else value for value in column.tolist()]


def _geometry_columns(geometry: BoxGeometry | None) -> dict[str, list[Any]]:
    if geometry is None:
        return {}
    return {
        "amodal_xyxy": geometry.amodal_xyxy.tolist(),
        "visible_xyxy": geometry.visible_xyxy.tolist(),
        "edges": [
            None if edges is None else np.asarray(edges).tolist()
            for edges in geometry.edges
        ],
    }


class _Limits(NamedTuple):
    """What sentences say of a class's limits, beside its thresholds."""

    min_visible_pixels: int
    min_distance: float | None
    max_distance: float | None


@lru_cache(maxsize=1024)
def _limits(config: FilterConfig, class_name: str) -> _Limits:
    return _Limits(
        int(config.limit_of(class_name, "min_visible_pixels") or 0),
        config.limit_of(class_name, "min_distance"),
        config.limit_of(class_name, "max_distance"),
    )


def _judgement(
    frame: FrameFacts,
    box: BoxFacts,
    accepted: tuple[str, ...],
    hiding: Sequence[HiddenBy],
) -> Judgement:
    config, name = frame.config, box.class_name
    limits = _limits(config, name)
    return Judgement(
        reason=box.reason,
        class_name=name,
        match_percent=_match_percent(box),
        threshold=_number(box.threshold),
        area_percent=_number(box.area_percent),
        large=box.large,
        matched_pixels=box.matched_pixels if box.measured else None,
        min_visible_pixels=limits.min_visible_pixels,
        distance=_number(box.distance),
        min_distance=limits.min_distance,
        max_distance=limits.max_distance,
        accepted=accepted,
        hidden_by=hiding,
        published=config.profile == "carlasimu",
        channel=_channel_judgement(frame, box, accepted),
    )


def _channel_judgement(
    frame: FrameFacts, box: BoxFacts, accepted: tuple[str, ...]
) -> ChannelJudgement | None:
    """None where the segmentation decided, or a rule that looks at no pixel."""
    facts, config = box.channel, frame.config
    if facts.used == SEMANTIC or box.reason not in DECIDED_BY_CHANNELS:
        return None
    nearer = frame.names.get(_position(facts.explained_by))
    needed = config.limit_of(box.class_name, "min_visible_pixels") or 0
    if facts.used == "ordered" and facts.explained_by is not None:
        needed = config.ordered_min_pixels
    elif facts.used == "lidar":
        needed = config.lidar_min_points
    return ChannelJudgement(
        channel=facts.used,
        kept=box.reason is Reason.VISIBLE,
        count=_COUNTS[facts.used](facts),
        needed=int(needed),
        gap=facts.center_gap if facts.used == "depth_center" else facts.depth_gap,
        explained_by=None if nearer is None else f"{nearer[1]} {nearer[0]}",
        accepted=accepted,
    )


_COUNTS: Final[Mapping[str, Callable[[ChannelFacts], int | None]]] = {
    "ordered": lambda facts: facts.owned_pixels,
    "depth": lambda facts: facts.depth_pixels,
    "depth_center": lambda _: None,
    "instance": lambda facts: facts.instance_pixels,
    "lidar": lambda facts: facts.lidar_points,
}


def _channel_used(box: BoxFacts) -> str | None:
    if box.channel.used != SEMANTIC:
        return box.channel.used
    return SEMANTIC if box.measured else None


def _match_percent(box: BoxFacts) -> float | None:
    # A box without a rectangle in the image has no pixels to have a share of.
    match = _number(box.match_percent) if box.box_pixels else None
    # The published code's float area can give more than all of a box's pixels.
    return None if match is None else min(match, 100.0)


def _position(explained_by: int | None) -> int:
    return NOT_MEASURED if explained_by is None else explained_by


def _number(value: float | None) -> float | None:
    # NaN alone differs from itself; this is asked six times for every box.
    return None if value is None or value != value else value


def _rectangle(xyxy: Sequence[float] | None) -> list[float] | None:
    return None if xyxy is None or math.isnan(xyxy[0]) else list(xyxy)
