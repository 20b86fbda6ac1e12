"""Counts the boxes of a filter exactly, and sums up tallies.

Tallies suffice unless a filter has ranges of numbers. Such filters are counted in the
columns that are cached in memory. The columns contain no answers: answered boxes, which
are few and have an index, are counted by the database and subtracted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.current import TallyKey, TallyRepository
from app.boxes.filter import BoxFilter, BoxProbes, selected
from app.context import ServiceContext
from app.db.tables import Dataset
from app.measuring.active import active_version, config_of
from app.measuring.columns import ColumnCache, DatasetColumns
from app.measuring.plan import active_measurement
from app.verdicts import REVIEW_STATES, effective_verdict, in_conflict, needs_review
from filter_core.config.filter import FilterConfig
from filter_core.types import Reason, Verdict


def count_boxes(
    context: ServiceContext, session: Session, dataset: Dataset, wanted: BoxFilter
) -> int:
    """The exact number of boxes of a filter."""
    tallies = TallyRepository(session).of_dataset(wanted.dataset_id)
    upper_bound = count_in_tallies(tallies, wanted)
    if not wanted.has_ranges or not upper_bound:
        return upper_bound
    by_numbers = wanted.effective is None and wanted.conflict is None
    held = by_numbers and context.one(ColumnCache).fits(session, dataset.id)
    # Answered boxes are few, and are counted by their index. If the filter selects all
    # others, the answered ones are subtracted from all boxes.
    others = REVIEW_STATES[wanted.review].others if wanted.review else None
    if not held or (wanted.review and others is None):
        return BoxProbes(session).count(wanted)
    measurement = active_measurement(session, dataset)
    numbers = context.one(ColumnCache).load(session, dataset.id, measurement.id)
    config = config_of(active_version(session, dataset))
    unreviewed = replace(wanted, review="")
    whole = numbers.counted(
        (config.digest, unreviewed), lambda: _selected(numbers, config, unreviewed)
    )
    if others is None:
        return whole
    return whole - BoxProbes(session).count(replace(wanted, review=others))


def _selected(numbers: DatasetColumns, config: FilterConfig, wanted: BoxFilter) -> int:
    chosen = selected(numbers, numbers.decided(config), wanted)
    return int(np.count_nonzero(chosen))


def count_in_tallies(tallies: Mapping[TallyKey, int], wanted: BoxFilter) -> int:
    """How many boxes the filter selects, ignoring its ranges: an upper bound."""
    return sum(boxes for key, boxes in tallies.items() if selects(wanted, key))


def selects(wanted: BoxFilter, key: TallyKey) -> bool:
    """Whether a filter without ranges selects the boxes of this tally."""
    return (
        (not wanted.reasons or key.reason in wanted.reasons)
        and (wanted.class_ids is None or key.class_id in wanted.class_ids)
        and (wanted.toss_up is None or key.toss_up is wanted.toss_up)
        and _fits_answer(wanted, key)
    )


def _fits_answer(wanted: BoxFilter, key: TallyKey) -> bool:
    effective = effective_verdict(key.reason, key.review)
    conflict = in_conflict(key.reason, key.review)
    return (
        (not wanted.review or key.review in REVIEW_STATES[wanted.review].answers)
        and (wanted.effective is None or effective == wanted.effective.value)
        and (wanted.conflict is None or conflict is wanted.conflict)
    )


@dataclass
class Counts:
    """Sums over current decisions."""

    boxes: int = 0
    verdicts: dict[str, int] = field(
        default_factory=lambda: {verdict.value: 0 for verdict in Verdict}
    )
    effective: dict[str, int] = field(
        default_factory=lambda: {verdict.value: 0 for verdict in Verdict}
    )
    by_reason: dict[str, int] = field(default_factory=dict)
    by_class: dict[int, dict[str, int]] = field(default_factory=dict)
    reasons_by_class: dict[int, dict[str, int]] = field(default_factory=dict)
    reviewed: int = 0
    unsure: int = 0
    to_review: int = 0
    conflicts: int = 0
    toss_ups: int = 0


def count(tallies: Mapping[TallyKey, int]) -> Counts:
    """Sum tallies up."""
    counts = Counts()
    for key, boxes in tallies.items():
        _add(counts, key, boxes)
    return counts


def _add(counts: Counts, key: TallyKey, boxes: int) -> None:
    reason = Reason(key.reason)
    verdict = reason.verdict.value
    effective = effective_verdict(key.reason, key.review)
    counts.boxes += boxes
    counts.verdicts[verdict] += boxes
    counts.effective[effective] += boxes
    counts.by_reason[reason.label] = counts.by_reason.get(reason.label, 0) + boxes
    of_class = counts.by_class.setdefault(
        key.class_id, {verdict.value: 0 for verdict in Verdict}
    )
    of_class[verdict] += boxes
    reasons = counts.reasons_by_class.setdefault(key.class_id, {})
    reasons[reason.label] = reasons.get(reason.label, 0) + boxes
    if key.review in REVIEW_STATES["decided"].answers:
        counts.reviewed += boxes
        counts.conflicts += boxes if in_conflict(key.reason, key.review) else 0
    counts.unsure += boxes if key.review == "unsure" else 0
    counts.toss_ups += boxes if key.toss_up else 0
    if needs_review(key.reason, key.toss_up, key.review):
        counts.to_review += boxes


def summary(counts: Counts) -> dict[str, int]:
    """The figures that cards and rows of frames show."""
    return {
        "boxes": counts.boxes,
        **counts.verdicts,
        "reviewed": counts.reviewed,
        "to_review": counts.to_review,
    }


def tallies_of(
    rows: Iterable[tuple[int, int, bool, str | None]],
) -> dict[TallyKey, int]:
    """Tallies of single boxes: class, reason, toss-up and review of each."""
    found: dict[TallyKey, int] = {}
    for class_id, reason, toss_up, review in rows:
        key = TallyKey(class_id, reason, toss_up, review or "")
        found[key] = found.get(key, 0) + 1
    return found
