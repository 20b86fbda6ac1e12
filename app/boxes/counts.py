"""Counts the boxes of a filter exactly, and sums up tallies.

Tallies suffice unless a filter has ranges of numbers. Such filters are counted in the
columns that are cached in memory. The columns contain no answers: answered boxes, which
are few and have an index, are counted by the database and subtracted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.current import TallyRepository
from app.boxes.filter import BoxFilter, BoxProbes, TallyKey, selected
from app.context import ServiceContext
from app.db.tables import Dataset
from app.measuring.active import active_config
from app.measuring.columns import ColumnCache
from app.measuring.plan import active_measurement
from app.verdicts import REVIEW_STATES, effective_verdict, in_conflict
from filter_core.decisions.doubt import Bin
from filter_core.verdicts import Reason, Verdict


def count_boxes(
    context: ServiceContext, session: Session, dataset: Dataset, box_filter: BoxFilter
) -> int:
    """The exact number of boxes of a filter."""
    tallies = TallyRepository(session).of_dataset(box_filter.dataset_id)
    upper_bound = count_in_tallies(tallies, box_filter)
    if not box_filter.is_beyond_tallies or not upper_bound:
        return upper_bound
    by_numbers = (
        box_filter.effective is None
        and box_filter.conflict is None
        and not box_filter.has_places
    )
    held = by_numbers and context.one(ColumnCache).fits(session, dataset.id)
    # Answered boxes are few, and are counted by their index. If the filter selects all
    others = REVIEW_STATES[box_filter.review].others if box_filter.review else None
    if not held or (box_filter.review and others is None):
        return BoxProbes(session).count(box_filter)
    measurement = active_measurement(session, dataset)
    numbers = context.one(ColumnCache).load(session, dataset.id, measurement.id)
    config = active_config(session, dataset)
    unreviewed = replace(box_filter, review="")
    whole = numbers.counted(
        (config.digest, unreviewed),
        lambda: int(np.count_nonzero(selected(numbers, config, unreviewed))),
    )
    if others is None:
        return whole
    return whole - BoxProbes(session).count(replace(box_filter, review=others))


def count_in_tallies(tallies: Mapping[TallyKey, int], box_filter: BoxFilter) -> int:
    """How many boxes the filter selects, ignoring its ranges: an upper bound."""
    return sum(boxes for key, boxes in tallies.items() if box_filter.selects(key))


def _no_verdicts() -> dict[str, int]:
    return {verdict.value: 0 for verdict in Verdict}


@dataclass
class Counts:
    """Sums over current decisions."""

    boxes: int = 0
    verdicts: dict[str, int] = field(default_factory=_no_verdicts)
    effective: dict[str, int] = field(default_factory=_no_verdicts)
    by_reason: Counter[str] = field(default_factory=Counter)
    by_class: dict[int, dict[str, int]] = field(default_factory=dict)
    reasons_by_class: dict[int, Counter[str]] = field(default_factory=dict)
    reviewed: int = 0
    unsure: int = 0
    conflicts: int = 0
    toss_ups: int = 0
    bins: dict[str, int] = field(
        default_factory=lambda: {bin_.label: 0 for bin_ in Bin}
    )
    """Boxes without a keep or reject, by their bin; those to ask are `to_review`."""


def count(tallies: Mapping[TallyKey, int]) -> Counts:
    """Sum tallies up."""
    counts = Counts()
    for key, boxes in tallies.items():
        reason = Reason(key.reason)
        verdict = reason.verdict.value
        counts.boxes += boxes
        counts.verdicts[verdict] += boxes
        counts.effective[effective_verdict(key.reason, key.review)] += boxes
        counts.by_reason[reason.label] += boxes
        counts.by_class.setdefault(key.class_id, _no_verdicts())[verdict] += boxes
        reasons = counts.reasons_by_class.setdefault(key.class_id, Counter())
        reasons[reason.label] += boxes
        if key.review in REVIEW_STATES["decided"].answers:
            counts.reviewed += boxes
            counts.conflicts += boxes if in_conflict(key.reason, key.review) else 0
        counts.unsure += boxes if key.review == "unsure" else 0
        counts.toss_ups += boxes if key.toss_up else 0
        if key.review in REVIEW_STATES["undecided"].answers:
            counts.bins[Bin(key.bin).label] += boxes
    return counts


def summary(counts: Counts) -> dict[str, int]:
    """The figures that cards and rows of frames show."""
    return {
        "boxes": counts.boxes,
        **counts.verdicts,
        "reviewed": counts.reviewed,
        "to_review": counts.bins[Bin.ASK.label],
    }


def tallies_of(
    rows: Iterable[tuple[int, int, bool, int, str | None]],
) -> dict[TallyKey, int]:
    """Tallies of single boxes: class, reason, toss-up, doubt and review of each."""
    tallies: dict[TallyKey, int] = {}
    for class_id, reason, toss_up, doubt, review in rows:
        key = TallyKey(class_id, reason, toss_up, min(doubt, Bin.ASK), review or "")
        tallies[key] = tallies.get(key, 0) + 1
    return tallies
