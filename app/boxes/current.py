"""Current decisions and tallies: the only functions that change them.

`decisions` has a row for each current box. `tallies` counts these rows by class,
reason, toss-up flag, bin and answer, so both tables have to change together:

- `copy_answers` and `copy_batch` (answers of people), `add` (new boxes) and `retire`
  (the boxes of a former frame) change both.
- `decided_again` and `classified_again` (a run) change decisions; their caller then
  calls `replace_tallies`.
- `doubt_again` (an upgrade) changes decisions; its caller then calls
  `recount_tallies`.
- `measured_again` (a run) changes only columns of decisions that tallies do not count.

Only `app.maintenance.removals` writes these tables as well: it deletes the rows of
deleted datasets. `DecisionRepository` and `TallyRepository`, at the end, only read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import (
    ColumnElement,
    Executable,
    Selectable,
    and_,
    bindparam,
    case,
    delete,
    func,
    insert,
    null,
    select,
    union_all,
    update,
)
from sqlalchemy.orm import Session

from app.boxes.filter import TallyKey
from app.db import bulk
from app.db.base import Repository, utc_now
from app.db.tables import Box, Decision, Frame, Review, Tally
from app.verdicts import BIN
from filter_core.arrays import BoolArray, IntArray, floats_or_none
from filter_core.decisions.doubt import Bin
from filter_core.evidence_numbers import Evidence
from filter_core.verdicts import Decisions

_TALLY: Final = ("dataset_id", *TallyKey._fields)
"""Columns of `tallies`, apart from the number of boxes."""

_ALIKE: Final = (Decision.class_id, Decision.reason, Decision.toss_up, BIN)
"""The values of decisions by which tallies count, apart from the answer."""


def copy_answers(session: Session, box_ids: Iterable[int]) -> None:
    """Copy new answers on these boxes from `reviews` into decisions and tallies.

    An answer is new if its revision is one above the revision of its box's decision.
    """
    for chunk in bulk.chunks(box_ids):
        _copy(session, _ON_BOXES, {"boxes": chunk})


def copy_batch(session: Session, batch_id: int) -> None:
    """As `copy_answers`, for the answers of a bulk answer."""
    _copy(session, _OF_BATCH, {"batch": batch_id})


def _copy(
    session: Session, which: ColumnElement[bool], values: Mapping[str, object]
) -> None:
    connection = session.connection()
    # In this order: the tallies are computed from the decisions before the change.
    for statement in _answers_copied(connection.dialect.name, which):
        connection.execute(statement, values)


# By box or by batch, not as "the newest answers": for those PostgreSQL would scan all
# answers while its statistics are out of date.
_ON_BOXES: Final = Review.box_id.in_(bindparam("boxes", expanding=True))
_OF_BATCH: Final = Review.batch_id == bindparam("batch")


# Here and below, statements are built once: every upload and every answer executes
# them, and building one takes several times as long.
@lru_cache
def _answers_copied(
    dialect: str, which: ColumnElement[bool]
) -> tuple[Executable, Executable]:
    """Boxes into the tallies of their new answers, and these into decisions."""
    # The answer directly follows the one that the decision has.
    follows = Review.revision == Decision.revision + 1
    is_next = and_(Decision.box_id == Review.box_id, follows)
    unchanged = (Decision.dataset_id, *_ALIKE)
    old = func.coalesce(Decision.review, "").label("old")
    new = case((Review.verdict == "clear", ""), else_=Review.verdict).label("new")
    # How many boxes get the answer `new` instead of `old`, for each tally of `old`.
    answered = (
        select(*unchanged, old, new, func.count().label("boxes"))
        .join(Review, is_next)
        .where(which)
        .group_by(*unchanged, old, new)
        .cte("answered")
    )
    same, boxes = [answered.c[column.name] for column in unchanged], answered.c.boxes
    changes = union_all(
        select(*same, answered.c.old.label("review"), (-boxes).label("boxes")),
        select(*same, answered.c.new, boxes),
    ).subquery()
    tally, change = [changes.c[name] for name in _TALLY], func.sum(changes.c.boxes)
    moved = select(*tally, change).group_by(*tally).having(change != 0)
    answer = case((Review.verdict == "clear", null()), else_=Review.verdict)
    rows = update(Decision).where(which, is_next)
    rows = rows.values(review=answer, revision=Review.revision)
    return _counted_in(dialect, moved), rows


def add(
    session: Session, dataset_id: int, columns: Mapping[str, Sequence[object]]
) -> None:
    """Store the decisions on new boxes without answers, and add them to the tallies.

    `columns` are those of `decisions`, all equally long.
    """
    bulk.insert_columns(session, Decision, columns)
    names = ("class_id", "reason", "toss_up", "doubt")
    alike = zip(*(columns[name] for name in names), strict=True)
    counts = Counter(
        TallyKey._make([*same, min(doubt, Bin.ASK), ""]) for *same, doubt in alike
    )
    dialect = session.connection().dialect.name
    bulk.run_each(session, _counted_in(dialect), _tally_rows(dataset_id, counts))


def retire(session: Session, frame: Frame) -> None:
    """Remove a frame's boxes from all lists and counts; its history stays."""
    dialect = session.connection().dialect.name
    bulk.run(session, _frame_out_of_tallies(dialect), frame_id=frame.id)
    session.execute(delete(Decision).where(Decision.frame_id == frame.id))
    former = update(Frame).where(Frame.id == frame.id)
    session.execute(former.values(superseded_at=utc_now()))


@lru_cache
def _frame_out_of_tallies(dialect: str) -> Executable:
    alike = (Decision.dataset_id, *_ALIKE, func.coalesce(Decision.review, ""))
    rows = select(*alike, -func.count()).group_by(*alike)
    return _counted_in(dialect, rows.where(Decision.frame_id == bindparam("frame_id")))


class Decided(NamedTuple):
    """The columns of N decisions that a configuration decides: (N,) arrays."""

    reason: NDArray[np.uint8]
    large: BoolArray
    toss_up: BoolArray
    doubt: NDArray[np.int16]

    def differs(self, other: Decided) -> BoolArray:
        """(N,): which boxes another configuration decides otherwise."""
        changed = np.zeros(len(self.reason), np.bool_)
        for column, of_other in zip(self, other, strict=True):
            changed |= column != of_other
        return changed

    def columns(self) -> dict[str, list[object]]:
        """As columns of `decisions`."""
        return {name: column.tolist() for name, column in self._asdict().items()}

    @classmethod
    def of(cls, decisions: Decisions, doubt: NDArray[np.int16]) -> Decided:
        """Those of the library's decisions, with the doubt about them."""
        return cls(decisions.reason, decisions.large, decisions.toss_up, doubt)


def doubt_again(session: Session, box_ids: IntArray, doubt: NDArray[np.int16]) -> None:
    """Replace the doubt about boxes, whatever it was.

    The caller has to recount the tallies of the dataset too (`recount_tallies`).
    """
    columns = {"box_id": box_ids.tolist(), "doubt": doubt.tolist()}
    bulk.update_rows(session, Decision, columns)


def decided_again(
    session: Session,
    box_ids: IntArray,
    before: Decided,
    after: Decided,
    written: bulk.Written,
) -> None:
    """Make `after` the current decisions of boxes where they differ from `before`.

    The caller has to replace the tallies of the dataset too (`replace_tallies`).

    Only the columns that have changed are written: to leave the indexes on the others
    alone saves a third of the time for a million rows.
    """
    changed = np.array([old != new for old, new in zip(before, after, strict=True)])
    patterns = np.packbits(changed, axis=0, bitorder="little")[0]
    for pattern in np.unique(patterns[patterns > 0]).tolist():
        rows = np.flatnonzero(patterns == pattern)
        columns = {"box_id": box_ids[rows].tolist()}
        for place, (name, column) in enumerate(after._asdict().items()):
            if pattern >> place & 1:
                columns[name] = column[rows].tolist()
        bulk.update_rows(session, Decision, columns, written)


def measured_again(
    session: Session, box_ids: IntArray, evidence: Evidence, written: bulk.Written
) -> None:
    """Copy the numbers that lists sort and filter by; tallies do not depend on them."""
    columns = {"box_id": box_ids.tolist(), **numbers_of_lists(evidence)}
    bulk.update_rows(session, Decision, columns, written)


def classified_again(session: Session, box_ids: IntArray, class_ids: IntArray) -> None:
    """Give boxes other classes, here and in `boxes`, since theirs were renamed.

    The caller has to replace the tallies of the dataset too (`replace_tallies`).
    """
    boxes, classes = box_ids.tolist(), class_ids.tolist()
    bulk.update_rows(session, Decision, {"box_id": boxes, "class_id": classes})
    bulk.update_rows(session, Box, {"id": boxes, "class_id": classes})


def numbers_of_lists(evidence: Evidence) -> dict[str, list[float | None]]:
    """The columns of `decisions` by which lists sort and filter, from the evidence."""
    low, high = evidence.distance_bounds()
    is_known = evidence.distance == evidence.distance
    return {
        "match_percent": floats_or_none(evidence.match_percent),
        # Never NaN: it is computed from the rectangles, and 0 for one without area.
        "crowding": evidence.crowding.tolist(),
        "distance": floats_or_none(evidence.distance),
        "distance_from": floats_or_none(np.where(is_known, np.nan, low)),
        "distance_to": floats_or_none(np.where(is_known, np.nan, high)),
    }


def replace_tallies(
    session: Session, dataset_id: int, counts: Mapping[TallyKey, int]
) -> None:
    """Replace all tallies of a dataset by these counts; `{}` deletes them."""
    session.execute(delete(Tally).where(Tally.dataset_id == dataset_id))
    bulk.insert_rows(session, Tally, _tally_rows(dataset_id, counts))


def recount_tallies(session: Session, dataset_id: int) -> None:
    """Count a dataset's decisions anew, after all of them may have changed."""
    session.execute(delete(Tally).where(Tally.dataset_id == dataset_id))
    alike = (Decision.dataset_id, *_ALIKE, func.coalesce(Decision.review, ""))
    rows = select(*alike, func.count()).group_by(*alike)
    counted = rows.where(Decision.dataset_id == dataset_id)
    session.execute(insert(Tally).from_select([*_TALLY, "boxes"], counted))


def _tally_rows(
    dataset_id: int, counts: Mapping[TallyKey, int]
) -> list[dict[str, int | str]]:
    return [
        {"dataset_id": dataset_id, **key._asdict(), "boxes": boxes}
        for key, boxes in counts.items()
        if boxes
    ]


@lru_cache
def _counted_in(dialect: str, changes: Selectable | None = None) -> Executable:
    """Insert tallies, or add to existing ones; as rows, or from a SELECT."""
    statement = bulk.insert_of_dialect(dialect, Tally)
    if changes is not None:
        statement = statement.from_select([*_TALLY, "boxes"], changes)
    return statement.on_conflict_do_update(
        index_elements=_TALLY, set_={"boxes": Tally.boxes + statement.excluded.boxes}
    )


class DecisionRepository(Repository):
    """Rows of `decisions`, read."""

    def per_frame(self, frame_ids: Sequence[int]) -> dict[int, dict[TallyKey, int]]:
        """The tallies of each frame: how many of its boxes share the same values."""
        alike = (Decision.frame_id, *_ALIKE, func.coalesce(Decision.review, ""))
        rows = select(*alike, func.count()).group_by(*alike)
        tallies: dict[int, dict[TallyKey, int]] = {key: {} for key in frame_ids}
        for row in self._session.execute(rows.where(Decision.frame_id.in_(frame_ids))):
            tallies[row[0]][TallyKey._make(row[1:-1])] = row[-1]
        return tallies

    def reviewed(self, dataset_id: int) -> list[tuple[int, str]]:
        """Box and answer of every reviewed box of a dataset, in order of id."""
        rows = select(Decision.box_id, Decision.review).where(
            Decision.dataset_id == dataset_id, Decision.review.is_not(None)
        )
        answers = self._session.execute(rows.order_by(Decision.box_id))
        return [(box_id, str(answer)) for box_id, answer in answers]


class TallyRepository(Repository):
    """Rows of `tallies`, read."""

    def of_dataset(self, dataset_id: int) -> dict[TallyKey, int]:
        """All tallies of a dataset that are not zero."""
        columns = (Tally.class_id, Tally.reason, Tally.toss_up, Tally.bin, Tally.review)
        rows = select(*columns, Tally.boxes)
        of_dataset = rows.where(Tally.dataset_id == dataset_id, Tally.boxes > 0)
        tallies = self._session.execute(of_dataset)
        return {TallyKey._make(row[:-1]): row[-1] for row in tallies}
