"""Which boxes two runs decide differently, over the frames that a dataset has now.

What runs have changed is stored, but any two of them, activated or not, are compared by
deciding again: numbers and configurations never change, and deciding is pure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.db.tables import Run
from app.errors import BadRequest, Conflict
from app.repositories.runs import ConfigRepository, RunRepository
from app.services.configs import config_of
from app.services.context import ServiceContext
from app.services.counting import VERDICT_CODE
from app.services.numbers import DatasetNumbers
from filter_core.decide import decide
from filter_core.types import (
    Decisions,
    FloatArray,
    IntArray,
    Reason,
    Verdict,
)

_CODE_OF: Final = {verdict.value: code for code, verdict in enumerate(Verdict)}
_KEPT_FIRST: Final = (Verdict.KEPT.value, Verdict.REJECTED.value)
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
) -> dict[str, Any]:
    """Counts of boxes whose verdict differs, and one page of them."""
    before, after = _decided(context, session, runs)
    verdicts = [VERDICT_CODE[each.reasons] for each in (before, after)]
    flips = np.flatnonzero(verdicts[0] != verdicts[1])
    sides = {
        f"{old}_to_{new}": np.flatnonzero(
            (verdicts[0] == _CODE_OF[old]) & (verdicts[1] == _CODE_OF[new])
        )
        for old, new in (_KEPT_FIRST, _KEPT_FIRST[::-1])
    }
    items, following = _page(before, after, flips, page)
    return {
        "run": runs[1].id,
        "against": runs[0].id,
        "compared": len(after.rows),
        "total": len(flips),
        **{name: len(those) for name, those in sides.items()},
        "by_class": _by_class(after, flips),
        "sides_by_class": _sides_by_class(after, sides),
        "items": items,
        "next_cursor": following,
    }


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


def _decided(
    context: ServiceContext, session: Session, runs: tuple[Run, Run]
) -> tuple[_Decided, _Decided]:
    numbers, decisions = [], []
    for run in runs:
        config = config_of(ConfigRepository(session).with_id(run.config_id))
        of_run = context.numbers.load(session, run.dataset_id, run.measurement_id or 0)
        numbers.append(of_run)
        decisions.append(decide(of_run.evidence, config))
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


def _by_class(after: _Decided, flips: IntArray) -> dict[str, int]:
    evidence = after.numbers.evidence
    counts = np.bincount(
        evidence.class_index[after.rows[flips]], minlength=len(evidence.class_names)
    )
    pairs = zip(evidence.class_names, counts.tolist(), strict=True)
    return {name: count for name, count in pairs if count}


def _sides_by_class(
    after: _Decided, sides: Mapping[str, IntArray]
) -> dict[str, dict[str, int]]:
    found = {name: _by_class(after, those) for name, those in sides.items()}
    classes = sorted({name for counts in found.values() for name in counts})
    return {
        class_name: {side: counts.get(class_name, 0) for side, counts in found.items()}
        for class_name in classes
    }


def _page(
    before: _Decided, after: _Decided, flips: IntArray, page: DiffPage
) -> tuple[list[dict[str, Any]], str | None]:
    """Flips in the order of their distance from the run's threshold, then of ids."""
    margins = np.abs(after.decisions.margin[after.rows[flips]])
    distances: FloatArray = np.nan_to_num(margins, nan=FARTHEST)
    ids = after.numbers.box_ids[after.rows[flips]]
    order = np.lexsort((ids, distances))
    if page.cursor is not None:
        distance, box_id = _place(page.cursor)
        later = (distances > distance) | ((distances == distance) & (ids > box_id))
        order = order[later[order]]
    listed = order[: page.limit]
    items = [_flip(before, after, int(flips[at])) for at in listed]
    if len(order) <= page.limit:
        return items, None
    last = listed[-1]
    return items, f"{float(distances[last])!r}~{int(ids[last])}"


def _place(cursor: str) -> tuple[float, int]:
    distance, _, box_id = cursor.partition("~")
    try:
        place = float(distance), int(box_id)
    except ValueError:
        place = float("nan"), 0
    if not place[0] >= 0 or not 0 < place[1] <= _MAX_ID:
        raise BadRequest(f"cursor {cursor!r} is not one of ours")
    return place


def _flip(before: _Decided, after: _Decided, at: int) -> dict[str, Any]:
    row, evidence = after.rows[at], after.numbers.evidence
    reasons = [Reason(int(each.reasons[at])) for each in (before, after)]
    match = float(evidence.match_percent[row])
    old, new = (
        {"verdict": reason.verdict.value, "reason": reason.label} for reason in reasons
    )
    return {
        "box_id": int(after.numbers.box_ids[row]),
        "frame_id": int(after.numbers.frame_ids[row]),
        "class": evidence.class_names[int(evidence.class_index[row])],
        "match_percent": None if match != match else match,
        "before": old,
        "after": new,
    }
