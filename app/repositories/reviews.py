"""Answers of people: added, never changed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from sqlalchemy import func, insert, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.db.bulk import chunks, update_rows
from app.db.tables import Decision, Review
from app.errors import Conflict


class LatestReview(NamedTuple):
    """The answer that counts for a box."""

    box_id: int
    revision: int
    verdict: str
    comment: str
    reviewer: str
    batch_id: int | None


class ReviewRepository:
    """Rows of `reviews`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def add(self, rows: Sequence[dict[str, Any]]) -> None:
        """Insert answers; unique (box, revision) settles a race between two people."""
        try:
            self._session.execute(insert(Review), list(rows))
        except IntegrityError as error:
            raise Conflict(
                "someone answered one of these boxes at the same moment; look again",
                code="stale_review",
            ) from error
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

    def of_box(self, box_id: int) -> list[Review]:
        """All answers on a box, oldest first."""
        rows = select(Review).where(Review.box_id == box_id).order_by(Review.revision)
        return list(self._session.scalars(rows))

    def latest(self, box_ids: Iterable[int]) -> dict[int, LatestReview]:
        """The newest answer of each box that has one."""
        found: dict[int, LatestReview] = {}
        for chunk in chunks(box_ids):
            found |= self._latest(chunk)
        return found

    def _latest(self, box_ids: Sequence[int]) -> dict[int, LatestReview]:
        newest = (
            select(Review.box_id, func.max(Review.revision).label("revision"))
            .where(Review.box_id.in_(box_ids))
            .group_by(Review.box_id)
            .subquery()
        )
        rows = select(
            Review.box_id,
            Review.revision,
            Review.verdict,
            Review.comment,
            Review.reviewer,
            Review.batch_id,
        ).join(
            newest,
            (Review.box_id == newest.c.box_id) & (Review.revision == newest.c.revision),
        )
        return {row[0]: LatestReview(*row) for row in self._session.execute(rows)}

    def newest_id(self) -> int:
        """The number of the newest answer of all datasets; 0 if there is none."""
        return self._session.scalar(select(func.max(Review.id))) or 0

    def last_id(self, dataset_id: int) -> int:
        """The number of the newest answer in a dataset; 0 if there is none."""
        rows = (
            select(func.max(Review.id))
            .join(Decision, Decision.box_id == Review.box_id)
            .where(Decision.dataset_id == dataset_id)
        )
        return self._session.scalar(rows) or 0
