"""What decides differently: under another configuration, or between two runs.

What runs have changed is stored, but any two of them, activated or not, are compared by
deciding again: numbers and configurations never change, and deciding is pure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.base import MAX_ID
from app.db.tables import Dataset, Run
from app.errors import BadCursor, BadRequest, Conflict
from app.measuring.active import active_version, config_of
from app.measuring.columns import (
    ColumnCache,
    DatasetColumns,
    flip_of,
    histogram,
    match_counts,
    outcome,
    reason_counts,
)
from app.measuring.evidence import recount
from app.measuring.plan import (
    DatasetReading,
    active_measurement,
    needs_pixels,
    plan_for,
)
from app.measuring.queries import (
    ConfigRepository,
    DatasetRepository,
    EvidenceRepository,
)
from app.runs.queries import RunRepository
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.decisions.rules import decide
from filter_core.types import (
    VERDICT_OF_REASON,
    Decisions,
    Evidence,
    FloatArray,
    IntArray,
    Reason,
    Verdict,
)
from unghost.wire.datasets import Histogram
from unghost.wire.runs import Diff, Flip, FlipCounts, Flips, Preview

_PREVIEW_SIDES: Final = ("kept_to_rejected", "rejected_to_kept")


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
    cache = context.one(ColumnCache)
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
        self._sides = {side: np.zeros(len(names), np.int64) for side in _PREVIEW_SIDES}
        self._flipped = 0
        self._closest: list[tuple[float, Flip]] = []

    def add(self, numbers: DatasetColumns, evidence: Evidence) -> None:
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
        for side, decisions in zip(_PREVIEW_SIDES, (before, after), strict=True):
            those = rows[decisions.reason[rows] == Reason.VISIBLE]
            self._sides[side] += np.bincount(
                evidence.class_index[those], minlength=len(self._names)
            )
        # Of equally close ones the first come first, in however many parts.
        listed = [
            (distance, _preview_flip(numbers, (before, after), evidence, row))
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


def _preview_flip(
    numbers: DatasetColumns,
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
    cache = context.one(ColumnCache)
    for (numbers,) in cache.parts(session, dataset.id, measurement.id):
        counts += numbers.match_counts(bins)
    return histogram(names, counts, config_of(active_version(session, dataset)))


def _recounted(
    session: Session, dataset: Dataset, numbers: DatasetColumns, plan: MeasureConfig
) -> Evidence:
    classes = DatasetRepository(session).classes(dataset.id)
    repository = EvidenceRepository(session)
    frame_ids = list(dict.fromkeys(numbers.frame_ids.tolist()))
    measurement = dataset.active_measurement_id or 0
    rows = repository.of_frames(frame_ids, measurement)
    parts = [recount(rows[key], classes, plan) for key in frame_ids]
    return _with_counts_of(parts, numbers.evidence) if parts else numbers.evidence


def _with_counts_of(frames: Sequence[Evidence], evidence: Evidence) -> Evidence:
    """The evidence of a dataset with what was counted again, frame by frame."""
    names = ("accept_mask", "matched_pixels", "match_percent", "crowding")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(one, name) for one in frames]) for name in names
    }
    return replace(evidence, **columns)


_KEPT, _REJECTED = (list(Verdict).index(v) for v in (Verdict.KEPT, Verdict.REJECTED))
_SIDES: Final = {
    "kept_to_rejected": (_KEPT, _REJECTED),
    "rejected_to_kept": (_REJECTED, _KEPT),
}
_ALL: Final = "total"
FARTHEST: Final = float("inf")


@dataclass(frozen=True)
class DiffPage:
    """Which flips are listed: those after a place, nearest to a threshold first."""

    limit: int
    cursor: str | None


@dataclass(frozen=True)
class _Decided:
    """What a run decides about boxes that the other one knows as well."""

    numbers: DatasetColumns
    decisions: Decisions
    rows: IntArray

    @property
    def reasons(self) -> NDArray[np.uint8]:
        return self.decisions.reason[self.rows]


def run_diff(
    context: ServiceContext,
    session: Session,
    runs: tuple[Run, Run],
    page: DiffPage,
) -> Diff:
    """Counts of boxes whose verdict differs, and one page of them."""
    configs = [
        config_of(ConfigRepository(session).with_id(run.config_id)) for run in runs
    ]
    measurements = [run.measurement_id or 0 for run in runs]
    diff = _Diff(page)
    cache = context.one(ColumnCache)
    for numbers in cache.parts(session, runs[1].dataset_id, *measurements):
        decisions = [
            decide(part.evidence, config)
            for part, config in zip(numbers, configs, strict=True)
        ]
        diff.add(*_compared(numbers, decisions))
    items, following = diff.page()
    sides = {side: diff.counts[side] for side in _SIDES}
    classes = sorted({name for counts in sides.values() for name in counts})
    # Parts meet the classes in other orders than the whole.
    names = DatasetRepository(session).classes(runs[1].dataset_id)
    of_all = diff.counts[_ALL]
    return Diff(
        run=runs[1].id,
        against=runs[0].id,
        compared=diff.compared,
        total=of_all.total(),
        **{side: counts.total() for side, counts in sides.items()},
        by_class={name: of_all[name] for name in names if of_all[name]},
        sides_by_class={
            name: FlipCounts(**{side: counts[name] for side, counts in sides.items()})
            for name in classes
        },
        items=items,
        next_cursor=following,
    )


def compared_runs(
    session: Session, run_id: int, against: int | None
) -> tuple[Run, Run]:
    """The run to compare with, and the run; by default the one that was active before.

    Raises
    ------
    Conflict
        One of them has decided nothing.
    BadRequest
        There is nothing to compare with, or it is of another dataset.
    """
    runs = RunRepository(session)
    run = runs.with_id(run_id)
    other_id = against or run.previous_run_id
    if other_id is None:
        raise BadRequest(
            f"run {run_id} is the first of its dataset; say ?against=ID",
            code="nothing_before",
        )
    other = runs.with_id(other_id)
    if other.dataset_id != run.dataset_id:
        raise BadRequest(
            f"run {other_id} is of another dataset than run {run_id}",
            code="other_dataset",
        )
    for each in (other, run):
        if each.state != "done":
            raise Conflict(
                f"run {each.id} is {each.state}; only runs that are done have decided",
                code="run_not_done",
            )
    return other, run


def _compared(
    numbers: Sequence[DatasetColumns], decisions: Sequence[Decisions]
) -> tuple[_Decided, _Decided]:
    before, after = numbers
    if before is after:
        rows = [np.arange(len(after))] * 2
    else:
        # Frames that came in between are measured under one measurement only.
        _, *rows = np.intersect1d(
            before.box_ids, after.box_ids, assume_unique=True, return_indices=True
        )
    return (
        _Decided(before, decisions[0], rows[0]),
        _Decided(after, decisions[1], rows[1]),
    )


class _Diff:
    """What differs in the parts of a dataset that were added so far."""

    def __init__(self, page: DiffPage) -> None:
        self._limit = page.limit
        self._after = None if page.cursor is None else _place(page.cursor)
        self._nearest: list[tuple[float, int, Flip]] = []
        self.compared = 0
        self.counts: dict[str, Counter[str]] = {_ALL: Counter()}
        self.counts |= {side: Counter() for side in _SIDES}

    def add(self, before: _Decided, after: _Decided) -> None:
        """Count a part, and keep what the page lists of it."""
        old, new = (VERDICT_OF_REASON[each.reasons] for each in (before, after))
        flips = np.flatnonzero(old != new)
        self.compared += len(after.rows)
        self.counts[_ALL] += _by_class(after, flips)
        for side, (was, is_now) in _SIDES.items():
            those = np.flatnonzero((old == was) & (new == is_now))
            self.counts[side] += _by_class(after, those)
        listed = [
            (distance, box_id, _flip(before, after, at))
            for distance, box_id, at in self._places(after, flips)
        ]
        merged = sorted([*self._nearest, *listed], key=lambda flip: flip[:2])
        self._nearest = merged[: self._limit + 1]

    def page(self) -> tuple[tuple[Flip, ...], str | None]:
        """The flips of the page, and where the next one begins."""
        listed = self._nearest[: self._limit]
        items = tuple(flip for _, _, flip in listed)
        if len(self._nearest) <= self._limit:
            return items, None
        distance, box_id, _ = listed[-1]
        return items, f"{distance!r}~{box_id}"

    def _places(self, after: _Decided, flips: IntArray) -> list[tuple[float, int, int]]:
        """The first by their distance from the run's threshold, then by their ids."""
        margins = np.abs(after.decisions.margin[after.rows[flips]])
        distances: FloatArray = np.nan_to_num(margins, nan=FARTHEST)
        ids = after.numbers.box_ids[after.rows[flips]]
        order = np.lexsort((ids, distances))
        if self._after is not None:
            distance, box_id = self._after
            later = (distances > distance) | ((distances == distance) & (ids > box_id))
            order = order[later[order]]
        # One more than the page has tells that there is another page.
        first = order[: self._limit + 1]
        columns = distances[first], ids[first], flips[first]
        return list(zip(*(column.tolist() for column in columns), strict=True))


def _by_class(after: _Decided, flips: IntArray) -> Counter[str]:
    evidence = after.numbers.evidence
    counts = np.bincount(
        evidence.class_index[after.rows[flips]], minlength=len(evidence.class_names)
    )
    pairs = zip(evidence.class_names, counts.tolist(), strict=True)
    return Counter({name: count for name, count in pairs if count})


def _place(cursor: str) -> tuple[float, int]:
    distance, _, box_id = cursor.partition("~")
    try:
        place = float(distance), int(box_id)
    except ValueError:
        place = float("nan"), 0
    if not place[0] >= 0 or not 0 < place[1] <= MAX_ID:
        raise BadCursor(cursor)
    return place


def _flip(before: _Decided, after: _Decided, at: int) -> Flip:
    row, numbers = after.rows[at], after.numbers
    ids = int(numbers.box_ids[row]), int(numbers.frame_ids[row])
    reasons = int(before.reasons[at]), int(after.reasons[at])
    return flip_of(ids, numbers.evidence, row, reasons)
