"""Current decisions and tallies: the one door through which they change."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

from sqlalchemy import case, delete, func, insert, null, select, update
from sqlalchemy.orm import Session

from app.boxes.filter import BoxFilter
from app.boxes.orders import Present
from app.boxes.queries import FrameRepository
from app.db.bulk import (
    Written,
    chunks,
    insert_columns,
    run_each,
    update_rows,
    upsert_in,
)
from app.db.tables import Box, Decision, Frame, Review, Tally
from app.errors import Forbidden, NotFound
from app.measuring.queries import is_deleted
from app.security import Principal, Role
from filter_core.types import Decisions, Evidence, FloatArray, IntArray


class CurrentRow(NamedTuple):
    """A current decision as it is stored."""

    box_id: int
    frame_id: int
    class_id: int
    reason: int
    toss_up: bool
    large: bool
    review: str | None
    revision: int


class TallyRow(NamedTuple):
    """How many boxes are alike in this."""

    class_id: int
    reason: int
    toss_up: bool
    review: str
    boxes: int


class DecisionRepository:
    """Rows of `decisions`, `flips` and `tallies`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def rows(self, box_ids: Iterable[int]) -> dict[int, CurrentRow]:
        """Current decisions of these boxes, by id."""
        found: dict[int, CurrentRow] = {}
        for chunk in chunks(box_ids):
            found |= self._fetch(Decision.box_id.in_(chunk))
        return found

    def dataset_of(self, box_id: int) -> int:
        """The dataset of a box that has a current decision."""
        rows = select(Decision.dataset_id).where(Decision.box_id == box_id)
        found = self._session.scalar(rows)
        if found is None or is_deleted(self._session, found):
            raise NotFound("box", box_id)
        return found

    def ids_in_dataset(self, box_ids: Iterable[int], dataset_id: int) -> set[int]:
        """Those of these boxes that are current boxes of the dataset."""
        found: set[int] = set()
        for chunk in chunks(box_ids):
            rows = select(Decision.box_id).where(
                Decision.box_id.in_(chunk), Decision.dataset_id == dataset_id
            )
            found.update(self._session.scalars(rows))
        return found

    def selection(self, wanted: BoxFilter, *, limit: int) -> list[int]:
        """Ids of all boxes of a filter, in order, up to a limit."""
        rows = (
            select(Decision.box_id)
            .where(*wanted.conditions())
            .order_by(Decision.box_id)
            .limit(limit)
        )
        return list(self._session.scalars(rows))

    def of_frames(self, frame_ids: Iterable[int]) -> dict[int, CurrentRow]:
        """Current decisions of the boxes of frames."""
        return self._fetch(Decision.frame_id.in_(list(frame_ids)))

    def answered_sources(
        self, frame_ids: Iterable[int]
    ) -> dict[int, list[tuple[str, str | None]]]:
        """The sender's own ids of boxes and their answers, in order, by frame."""
        frames = list(frame_ids)
        found: dict[int, list[tuple[str, str | None]]] = {key: [] for key in frames}
        rows = (
            select(Decision.frame_id, Box.source_id, Decision.review)
            .join(Box, Box.id == Decision.box_id)
            .where(Decision.frame_id.in_(frames))
            .order_by(Decision.box_id)
        )
        for frame_id, source_id, review in self._session.execute(rows):
            found[frame_id].append((source_id, review))
        return found

    def per_frame(self, frame_ids: Sequence[int]) -> dict[int, list[TallyRow]]:
        """Tallies of single frames."""
        review = func.coalesce(Decision.review, "")
        rows = (
            select(
                Decision.frame_id,
                Decision.class_id,
                Decision.reason,
                Decision.toss_up,
                review,
                func.count(),
            )
            .where(Decision.frame_id.in_(frame_ids))
            .group_by(
                Decision.frame_id,
                Decision.class_id,
                Decision.reason,
                Decision.toss_up,
                review,
            )
        )
        found: dict[int, list[TallyRow]] = {key: [] for key in frame_ids}
        for row in self._session.execute(rows):
            found[row[0]].append(TallyRow(row[1], row[2], row[3], row[4], row[5]))
        return found

    def refresh(
        self, box_ids: IntArray, before: Decisions, after: Decisions, written: Written
    ) -> None:
        """Make these the current decisions; `before` are the ones they replace.

        Most changes leave the flags alone. Updating only the reason then spares the
        two partial indexes, which is a third of the cost of a million rows.
        """
        flags = (before.large != after.large) | (before.toss_up != after.toss_up)
        plain = ~flags
        update_rows(
            self._session,
            Decision,
            {
                "box_id": box_ids[plain].tolist(),
                "reason": after.reason[plain].tolist(),
            },
            written,
        )
        update_rows(
            self._session,
            Decision,
            {
                "box_id": box_ids[flags].tolist(),
                "reason": after.reason[flags].tolist(),
                "large": after.large[flags].tolist(),
                "toss_up": after.toss_up[flags].tolist(),
            },
            written,
        )

    def refresh_numbers(
        self, box_ids: IntArray, evidence: Evidence, written: Written
    ) -> None:
        """Copy the numbers that lists sort and filter by."""

        def known(column: FloatArray) -> list[float | None]:
            return [None if value != value else value for value in column.tolist()]

        update_rows(
            self._session,
            Decision,
            {
                "box_id": box_ids.tolist(),
                "match_percent": known(evidence.match_percent),
                "crowding": [value or 0.0 for value in known(evidence.crowding)],
                "distance": known(evidence.distance),
            },
            written,
        )

    def answered(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Make these answers, rows that were added to `reviews`, the latest ones."""
        update_rows(
            self._session,
            Decision,
            {
                "box_id": [row["box_id"] for row in rows],
                "review": [
                    None if row["verdict"] == "clear" else row["verdict"]
                    for row in rows
                ],
                "revision": [row["revision"] for row in rows],
            },
        )

    def answered_in(self, batch_id: int) -> None:
        """Make the answers of an act on many boxes the latest ones."""
        self._session.connection().execute(
            update(Decision)
            .where(Review.batch_id == batch_id, Decision.box_id == Review.box_id)
            .values(
                review=case((Review.verdict == "clear", null()), else_=Review.verdict),
                revision=Review.revision,
            )
        )

    def _fetch(self, condition: object) -> dict[int, CurrentRow]:
        rows = (
            select(
                Decision.box_id,
                Decision.frame_id,
                Decision.class_id,
                Decision.reason,
                Decision.toss_up,
                Decision.large,
                Decision.review,
                Decision.revision,
            )
            .where(condition)  # type: ignore[arg-type]  # any condition
            .order_by(Decision.box_id)
        )
        return {row[0]: CurrentRow(*row) for row in self._session.execute(rows)}


class TallyKey(NamedTuple):
    """What boxes of one tally have in common; `review` is empty without an answer."""

    class_id: int
    reason: int
    toss_up: bool
    review: str


class TallyRepository:
    """Rows of `tallies`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def of_dataset(self, dataset_id: int) -> dict[TallyKey, int]:
        """All tallies of a dataset that are not zero."""
        rows = select(
            Tally.class_id, Tally.reason, Tally.toss_up, Tally.review, Tally.boxes
        ).where(Tally.dataset_id == dataset_id, Tally.boxes > 0)
        return {
            TallyKey(row[0], row[1], row[2], row[3]): row[4]
            for row in self._session.execute(rows)
        }

    def add(self, dataset_id: int, changes: Mapping[TallyKey, int]) -> None:
        """Count these boxes in (or out, where negative)."""
        rows = [
            {"dataset_id": dataset_id, **key._asdict(), "boxes": change}
            for key, change in changes.items()
            if change
        ]
        if not rows:
            return
        dialect = self._session.connection().dialect.name
        run_each(self._session, _count_in(dialect), rows)

    def replace(self, dataset_id: int, counts: Mapping[TallyKey, int]) -> None:
        """Set all tallies of a dataset."""
        self._session.execute(delete(Tally).where(Tally.dataset_id == dataset_id))
        self._insert(dataset_id, counts)

    def clear(self, dataset_id: int) -> None:
        """Count nothing any more: the dataset is deleted."""
        self._session.execute(delete(Tally).where(Tally.dataset_id == dataset_id))

    def present(self, dataset_id: int) -> Present:
        """What occurs in a dataset."""
        found = self.of_dataset(dataset_id)
        has_large = select(Decision.box_id).where(
            Decision.dataset_id == dataset_id, Decision.large.is_(True)
        )
        return Present(
            reasons=tuple(sorted({key.reason for key in found})),
            class_ids=frozenset(key.class_id for key in found),
            toss_ups=any(key.toss_up for key in found),
            large=self._session.scalar(has_large.limit(1)) is not None,
        )

    def reviewed(self, dataset_id: int) -> list[tuple[int, str]]:
        """Box and answer of every reviewed box of a dataset, in order of id."""
        rows = (
            select(Decision.box_id, Decision.review)
            .where(Decision.dataset_id == dataset_id, Decision.review.is_not(None))
            .order_by(Decision.box_id)
        )
        return [(row[0], str(row[1])) for row in self._session.execute(rows)]

    def _insert(self, dataset_id: int, counts: Mapping[TallyKey, int]) -> None:
        rows = [
            {"dataset_id": dataset_id, **key._asdict(), "boxes": boxes}
            for key, boxes in counts.items()
            if boxes
        ]
        if rows:
            self._session.execute(insert(Tally), rows)


@lru_cache
def _count_in(dialect: str) -> Any:  # noqa: ANN401  # of either dialect
    # Built once: every upload runs it, and building costs five times as much.
    statement = upsert_in(dialect, Tally)
    return statement.on_conflict_do_update(
        index_elements=["dataset_id", *TallyKey._fields],
        set_={"boxes": Tally.boxes + statement.excluded.boxes},
    )


def add(
    session: Session, dataset_id: int, columns: Mapping[str, Sequence[Any]]
) -> None:
    """Store the decisions on new boxes, which nobody has answered, and count them in.

    `columns` are those of `decisions`, all equally long.
    """
    insert_columns(session, Decision, columns)
    alike = Counter(
        zip(columns["class_id"], columns["reason"], columns["toss_up"], strict=True)
    )
    TallyRepository(session).add(
        dataset_id, {TallyKey(*key, ""): boxes for key, boxes in alike.items()}
    )


def retire(session: Session, frame: Frame) -> None:
    """Take a frame's boxes out of every list and count; its history stays."""
    gone = DecisionRepository(session).per_frame([frame.id])[frame.id]
    TallyRepository(session).add(
        frame.dataset_id, {TallyKey(*row[:-1]): -row.boxes for row in gone}
    )
    FrameRepository(session).supersede(frame)


_NAMED: Final = 3


def require_own(by: Principal, answers: Mapping[str, int], act: str) -> int:
    """Let through whoever does away with nobody's answers but their own, and admins.

    Parameters
    ----------
    answers : mapping of str to int
        How many answers would be lost, taken back or set aside, by reviewer.
    act : str
        What is asked for, as the message begins: ``deleting frame 'a/1'``.

    Returns
    -------
    int
        How many of the answers are other people's.

    Raises
    ------
    Forbidden
        Some are, and this is no admin.
    """
    others = {name: number for name, number in answers.items() if name != by.name}
    number = sum(others.values())
    if number and not by.role.includes(Role.ADMIN):
        raise Forbidden(
            f"{act} concerns {number} {'answer' if number == 1 else 'answers'} of "
            f"{_named(sorted(others))}: this needs the role admin, "
            f"token {by.name!r} has {by.role.value}",
            code="others_answers",
        )
    return number


def _named(names: list[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
