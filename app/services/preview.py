"""What another configuration would decide; nothing is written, no pixel is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sqlalchemy.orm import Session

from app.db.tables import Dataset
from app.repositories.datasets import DatasetRepository
from app.repositories.evidence import EvidenceRepository
from app.services.configs import active_version, config_of
from app.services.context import ServiceContext
from app.services.measuring import DatasetReading, plan_for
from app.services.numbers import DatasetNumbers
from app.services.recounting import recount
from app.services.run_requests import active_measurement
from filter_core.config import FilterConfig
from filter_core.decide import decide
from filter_core.types import Decisions, Evidence, IntArray, Reason, Verdict

MAX_PERCENT = 100.0


@dataclass(frozen=True)
class Histogram:
    """match_percent per class."""

    edges: list[float]
    classes: dict[str, list[int]]
    thresholds: dict[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "edges": self.edges,
            "classes": self.classes,
            "thresholds": self.thresholds,
        }


@dataclass(frozen=True)
class PreviewLimits:
    """How many flips are listed, and into how many bins matches are counted."""

    flips: int
    bins: int


def preview(
    context: ServiceContext,
    session: Session,
    dataset: Dataset,
    config: FilterConfig,
    limits: PreviewLimits,
) -> dict[str, Any]:
    """Counts, histograms and flips."""
    plan = plan_for(DatasetReading.of(dataset), config)
    measurement = active_measurement(session, dataset)
    if plan.pixel_digest != measurement.pixel_digest:
        return _needs_pixels(config)
    numbers = active_numbers(context, session, dataset)
    evidence = numbers.evidence
    if plan.digest != measurement.digest:
        evidence = _recounted(session, dataset, numbers, config)
    active = config_of(active_version(session, dataset))
    before, after = decide(numbers.evidence, active), decide(evidence, config)
    return {
        "config": config.digest,
        "needs_pixels": False,
        "counts": {verdict.value: after.count(verdict) for verdict in Verdict},
        "by_reason": by_reason(after),
        "by_class": by_class(evidence, after),
        "histograms": histogram(evidence, config, limits.bins).as_dict(),
        "flips": _flips(numbers, (before, after), evidence, limits.flips),
    }


def active_numbers(
    context: ServiceContext, session: Session, dataset: Dataset
) -> DatasetNumbers:
    """The current numbers of a dataset."""
    measurement = active_measurement(session, dataset)
    return context.numbers.load(session, dataset.id, measurement.id)


def histogram(evidence: Evidence, config: FilterConfig, bins: int) -> Histogram:
    """match_percent of each class that occurs, in equal bins from 0 to 100."""
    edges = np.linspace(0.0, MAX_PERCENT, bins + 1)
    scaled = np.nan_to_num(evidence.match_percent, nan=0.0) * (bins / MAX_PERCENT)
    bin_of = np.clip(scaled.astype(np.int64), 0, bins - 1)
    packed = evidence.class_index.astype(np.int64) * bins + bin_of
    counts = np.bincount(
        packed[evidence.measured], minlength=len(evidence.class_names) * bins
    ).reshape(-1, bins)
    limits = config.thresholds_for(evidence.class_names).threshold_small_box
    occurs = [int(index) for index in np.flatnonzero(counts.sum(axis=1))]
    names = evidence.class_names
    return Histogram(
        edges=edges.tolist(),
        classes={names[index]: counts[index].tolist() for index in occurs},
        thresholds={names[index]: float(limits[index]) for index in occurs},
    )


def by_reason(decisions: Decisions) -> dict[str, int]:
    """How many boxes each reason decided."""
    counts = np.bincount(decisions.reason, minlength=max(Reason) + 1)
    return {reason.label: int(counts[reason]) for reason in Reason if counts[reason]}


def by_class(evidence: Evidence, decisions: Decisions) -> dict[str, dict[str, int]]:
    """How many boxes of each class got each verdict."""
    verdicts = list(Verdict)
    code = np.zeros(max(Reason) + 1, np.int64)
    for reason in Reason:
        code[reason] = verdicts.index(reason.verdict)
    packed = evidence.class_index.astype(np.int64) * 3 + code[decisions.reason]
    counts = np.bincount(packed, minlength=len(evidence.class_names) * 3)
    table = counts.reshape(-1, 3).tolist()
    return {
        name: {verdict.value: row[at] for at, verdict in enumerate(verdicts)}
        for name, row in zip(evidence.class_names, table, strict=True)
        if any(row)
    }


def _needs_pixels(config: FilterConfig) -> dict[str, Any]:
    unknown = ("counts", "by_reason", "by_class", "histograms", "flips")
    return {
        "config": config.digest,
        "needs_pixels": True,
        **dict.fromkeys(unknown),
    }


def _flips(
    numbers: DatasetNumbers,
    decisions: tuple[Decisions, Decisions],
    evidence: Evidence,
    limit: int,
) -> dict[str, Any]:
    before, after = decisions
    flipped = _verdicts(before) != _verdicts(after)
    rows = np.flatnonzero(flipped)
    kept_before = before.reason[rows] == Reason.VISIBLE
    kept_after = after.reason[rows] == Reason.VISIBLE
    closest = _closest(rows, after, limit)
    return {
        "total": len(rows),
        "kept_to_rejected": int((kept_before & ~kept_after).sum()),
        "rejected_to_kept": int((~kept_before & kept_after).sum()),
        "items": [_flip(numbers, decisions, evidence, row) for row in closest],
    }


def _closest(rows: IntArray, after: Decisions, limit: int) -> list[int]:
    """The flips that are nearest to the new threshold: the ones to look at."""
    distance = np.nan_to_num(np.abs(after.margin[rows]), nan=np.inf)
    chosen: list[int] = rows[np.argsort(distance, kind="stable")[:limit]].tolist()
    return chosen


def _flip(
    numbers: DatasetNumbers,
    decisions: tuple[Decisions, Decisions],
    evidence: Evidence,
    row: int,
) -> dict[str, Any]:
    before, after = (Reason(int(each.reason[row])) for each in decisions)
    match = float(evidence.match_percent[row])
    return {
        "box_id": int(numbers.box_ids[row]),
        "frame_id": int(numbers.frame_ids[row]),
        "class": evidence.class_names[int(evidence.class_index[row])],
        "match_percent": None if match != match else match,
        "before": {"verdict": before.verdict.value, "reason": before.label},
        "after": {"verdict": after.verdict.value, "reason": after.label},
    }


def _verdicts(decisions: Decisions) -> IntArray:
    code = np.zeros(max(Reason) + 1, np.int64)
    for reason in Reason:
        code[reason] = list(Verdict).index(reason.verdict)
    verdicts: IntArray = code[decisions.reason]
    return verdicts


def _recounted(
    session: Session, dataset: Dataset, numbers: DatasetNumbers, config: FilterConfig
) -> Evidence:
    classes = DatasetRepository(session).classes(dataset.id)
    repository = EvidenceRepository(session)
    frame_ids = list(dict.fromkeys(numbers.frame_ids.tolist()))
    measurement = dataset.active_measurement_id or 0
    rows = repository.of_frames(frame_ids, measurement)
    parts = [recount(rows[key], classes, config) for key in frame_ids]
    return _joined(numbers.evidence, parts) if parts else numbers.evidence


def _joined(whole: Evidence, parts: Sequence[Evidence]) -> Evidence:
    names = ("accept_mask", "matched_pixels", "match_percent", "crowding")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in names
    }
    return replace(whole, **columns)
