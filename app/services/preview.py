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
from app.services.counting import VERDICT_CODE, histogram, match_counts, outcome
from app.services.measuring import DatasetReading, plan_for
from app.services.numbers import DatasetNumbers
from app.services.recounting import recount
from app.services.run_requests import active_measurement, needs_pixels
from filter_core.config import FilterConfig
from filter_core.decide import decide
from filter_core.types import Decisions, Evidence, IntArray, Reason


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
    if needs_pixels(session, dataset, plan):
        return _needs_pixels(config)
    numbers = active_numbers(context, session, dataset)
    evidence = numbers.evidence
    if not plan.is_covered_by(measurement.options):
        evidence = _recounted(session, dataset, numbers, config)
    active = config_of(active_version(session, dataset))
    before, after = numbers.decided(active), decide(evidence, config)
    same_matches = evidence is numbers.evidence
    matches = (
        numbers.match_counts(limits.bins)
        if same_matches
        else match_counts(evidence, limits.bins)
    )
    return {
        "config": config.digest,
        "needs_pixels": False,
        **outcome(evidence, after),
        "histograms": histogram(evidence.class_names, matches, config),
        "flips": _flips(numbers, (before, after), evidence, limits.flips),
    }


def active_numbers(
    context: ServiceContext, session: Session, dataset: Dataset
) -> DatasetNumbers:
    """The current numbers of a dataset."""
    measurement = active_measurement(session, dataset)
    return context.numbers.load(session, dataset.id, measurement.id)


def _needs_pixels(config: FilterConfig) -> dict[str, Any]:
    unknown = (
        "counts",
        "by_reason",
        "by_class",
        "reasons_by_class",
        "histograms",
        "flips",
    )
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
    rows = np.flatnonzero(VERDICT_CODE[before.reason] != VERDICT_CODE[after.reason])
    lost = rows[before.reason[rows] == Reason.VISIBLE]
    won = rows[after.reason[rows] == Reason.VISIBLE]
    closest = _closest(rows, after, limit)
    return {
        "total": len(rows),
        "kept_to_rejected": len(lost),
        "rejected_to_kept": len(won),
        "by_class": _by_class(evidence, lost, won),
        "items": [_flip(numbers, decisions, evidence, row) for row in closest],
    }


def _by_class(evidence: Evidence, lost: IntArray, won: IntArray) -> dict[str, Any]:
    names = evidence.class_names
    fewer, more = (
        np.bincount(evidence.class_index[rows], minlength=len(names)).tolist()
        for rows in (lost, won)
    )
    return {
        name: {"kept_to_rejected": fewer[index], "rejected_to_kept": more[index]}
        for index, name in enumerate(names)
        if fewer[index] or more[index]
    }


def _closest(rows: IntArray, after: Decisions, limit: int) -> list[int]:
    """The flips that are nearest to the new threshold: the ones to look at."""
    if not limit:
        return []
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
