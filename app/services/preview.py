"""What another configuration would decide; nothing is written, no pixel is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.tables import Dataset
from app.repositories.datasets import DatasetRepository
from app.repositories.evidence import EvidenceRepository
from app.services.configs import active_version, config_of
from app.services.counting import (
    flip_of,
    histogram,
    match_counts,
    outcome,
    reason_counts,
)
from app.services.measuring import DatasetReading, plan_for
from app.services.numbers import DatasetNumbers, NumbersCache
from app.services.recounting import recount
from app.services.run_requests import active_measurement, needs_pixels
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.decisions.rules import decide
from filter_core.types import VERDICT_OF_REASON, Decisions, Evidence, IntArray, Reason
from unghost.wire.datasets import Histogram
from unghost.wire.runs import Flip, FlipCounts, Flips, Preview

_SIDES: Final = ("kept_to_rejected", "rejected_to_kept")


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
) -> Preview:
    """Counts, histograms and flips."""
    plan = plan_for(DatasetReading.of(dataset), config)
    measurement = active_measurement(session, dataset)
    if needs_pixels(session, dataset, plan):
        return Preview(config=config.digest, needs_pixels=True)
    is_recounted = not plan.is_covered_by(measurement.options)
    names = tuple(DatasetRepository(session).classes(dataset.id))
    found = _Preview(names, config_of(active_version(session, dataset)), config, limits)
    cache = context.one(NumbersCache)
    for (numbers,) in cache.parts(session, dataset.id, measurement.id):
        evidence = numbers.evidence
        if is_recounted:
            evidence = _recounted(session, dataset, numbers, plan)
        found.add(numbers, evidence)
    return found.answer()


class _Preview:
    """What would be decided of the parts of a dataset that were added so far."""

    def __init__(
        self,
        names: tuple[str, ...],
        active: FilterConfig,
        config: FilterConfig,
        limits: PreviewLimits,
    ) -> None:
        self._names, self._active, self._config = names, active, config
        self._limits = limits
        self._reasons: IntArray = np.zeros(
            (len(names), len(VERDICT_OF_REASON)), np.int64
        )
        self._matches: IntArray = np.zeros((len(names), limits.bins), np.int64)
        self._sides = {side: np.zeros(len(names), np.int64) for side in _SIDES}
        self._flipped = 0
        self._closest: list[tuple[float, Flip]] = []

    def add(self, numbers: DatasetNumbers, evidence: Evidence) -> None:
        """Count a part; `evidence` is that of its numbers, or counted again."""
        before = numbers.decided(self._active)
        after = decide(evidence, self._config)
        self._reasons += reason_counts(evidence, after)
        self._matches += (
            numbers.match_counts(self._limits.bins)
            if evidence is numbers.evidence
            else match_counts(evidence, self._limits.bins)
        )
        rows = np.flatnonzero(
            VERDICT_OF_REASON[before.reason] != VERDICT_OF_REASON[after.reason]
        )
        self._flipped += len(rows)
        for side, decisions in zip(_SIDES, (before, after), strict=True):
            those = rows[decisions.reason[rows] == Reason.VISIBLE]
            self._sides[side] += np.bincount(
                evidence.class_index[those], minlength=len(self._names)
            )
        # Of equally close ones the first come first, in however many parts.
        listed = [
            (distance, _flip(numbers, (before, after), evidence, row))
            for distance, row in _closest(rows, after, self._limits.flips)
        ]
        merged = sorted([*self._closest, *listed], key=lambda flip: flip[0])
        self._closest = merged[: self._limits.flips]

    def answer(self) -> Preview:
        """As it is answered."""
        return Preview(
            config=self._config.digest,
            needs_pixels=False,
            **outcome(self._names, self._reasons),
            histograms=histogram(self._names, self._matches, self._config),
            flips=self._flips(),
        )

    def _flips(self) -> Flips:
        by_class = {
            name: FlipCounts(
                **{side: int(counts[index]) for side, counts in self._sides.items()}
            )
            for index, name in enumerate(self._names)
        }
        nobody = FlipCounts()
        return Flips(
            total=self._flipped,
            **{side: int(counts.sum()) for side, counts in self._sides.items()},
            by_class={name: of for name, of in by_class.items() if of != nobody},
            items=tuple(flip for _, flip in self._closest),
        )


def _closest(rows: IntArray, after: Decisions, limit: int) -> list[tuple[float, int]]:
    """The flips that are nearest to the new threshold: the ones to look at."""
    if not limit:
        return []
    distance = np.nan_to_num(np.abs(after.margin[rows]), nan=np.inf)
    order = np.argsort(distance, kind="stable")[:limit]
    return list(zip(distance[order].tolist(), rows[order].tolist(), strict=True))


def _flip(
    numbers: DatasetNumbers,
    decisions: tuple[Decisions, Decisions],
    evidence: Evidence,
    row: int,
) -> Flip:
    before, after = (int(each.reason[row]) for each in decisions)
    ids = int(numbers.box_ids[row]), int(numbers.frame_ids[row])
    return flip_of(ids, evidence, row, (before, after))


def current_histogram(
    context: ServiceContext, session: Session, dataset: Dataset, bins: int
) -> Histogram:
    """Matches per class as they are, with the active configuration's thresholds."""
    measurement = active_measurement(session, dataset)
    names = tuple(DatasetRepository(session).classes(dataset.id))
    counts: IntArray = np.zeros((len(names), bins), np.int64)
    cache = context.one(NumbersCache)
    for (numbers,) in cache.parts(session, dataset.id, measurement.id):
        counts += numbers.match_counts(bins)
    return histogram(names, counts, config_of(active_version(session, dataset)))


def _recounted(
    session: Session, dataset: Dataset, numbers: DatasetNumbers, plan: MeasureConfig
) -> Evidence:
    classes = DatasetRepository(session).classes(dataset.id)
    repository = EvidenceRepository(session)
    frame_ids = list(dict.fromkeys(numbers.frame_ids.tolist()))
    measurement = dataset.active_measurement_id or 0
    rows = repository.of_frames(frame_ids, measurement)
    parts = [recount(rows[key], classes, plan) for key in frame_ids]
    return _joined(numbers.evidence, parts) if parts else numbers.evidence


def _joined(whole: Evidence, parts: Sequence[Evidence]) -> Evidence:
    names = ("accept_mask", "matched_pixels", "match_percent", "crowding")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in names
    }
    return replace(whole, **columns)
