"""Tallies: how many current decisions are alike, kept up as they change."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

from sqlalchemy import delete, insert, select
from sqlalchemy.orm import Session

from app.db.bulk import run_each, upsert_in
from app.db.tables import Decision, Tally
from app.repositories.box_orders import Present


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


def tally(keys: Iterable[TallyKey]) -> Counter[TallyKey]:
    """Count boxes that are alike."""
    return Counter(keys)
