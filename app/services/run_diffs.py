"""Which boxes two runs decide differently, over the frames that a dataset has now.

What runs have changed is stored, but any two of them, activated or not, are compared by
deciding again: numbers and configurations never change, and deciding is pure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.tables import Run
from app.errors import BadRequest, Conflict
from app.repositories.datasets import DatasetRepository
from app.repositories.runs import ConfigRepository, RunRepository
from app.services.configs import config_of
from app.services.counting import flip_of
from app.services.numbers import DatasetNumbers, NumbersCache
from filter_core.decisions.rules import decide
from filter_core.types import (
    VERDICT_OF_REASON,
    Decisions,
    FloatArray,
    IntArray,
    Verdict,
)
from unghost.wire.runs import Diff, Flip, FlipCounts

_KEPT, _REJECTED = (list(Verdict).index(v) for v in (Verdict.KEPT, Verdict.REJECTED))
_SIDES: Final = {
    "kept_to_rejected": (_KEPT, _REJECTED),
    "rejected_to_kept": (_REJECTED, _KEPT),
}
_ALL: Final = "total"
FARTHEST: Final = float("inf")
_MAX_ID: Final = 2**63 - 1


@dataclass(frozen=True)
class DiffPage:
    """Which flips are listed: those after a place, nearest to a threshold first."""

    limit: int
    cursor: str | None


@dataclass(frozen=True)
class _Decided:
    """What a run decides about boxes that the other one knows as well."""

    numbers: DatasetNumbers
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
    cache = context.one(NumbersCache)
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
    numbers: Sequence[DatasetNumbers], decisions: Sequence[Decisions]
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
    if not place[0] >= 0 or not 0 < place[1] <= _MAX_ID:
        raise BadRequest(f"cursor {cursor!r} is not one of ours")
    return place


def _flip(before: _Decided, after: _Decided, at: int) -> Flip:
    row, numbers = after.rows[at], after.numbers
    ids = int(numbers.box_ids[row]), int(numbers.frame_ids[row])
    reasons = int(before.reasons[at]), int(after.reasons[at])
    return flip_of(ids, numbers.evidence, row, reasons)
