"""What can be counted from tallies, without looking at a box."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from app.repositories.tallies import TallyKey
from app.verdicts import effective_verdict, in_conflict, needs_review
from filter_core.types import Reason, Verdict


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
    if key.review in ("keep", "reject"):
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
