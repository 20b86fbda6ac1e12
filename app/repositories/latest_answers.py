"""The answers that count now, as those read them who show or write boxes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from app.db.bulk import chunks
from app.db.tables import Box, Decision, Frame, Review
from filter_core.types import IntArray


class LatestReview(NamedTuple):
    """The answer that counts for a box."""

    box_id: int
    revision: int
    verdict: str
    comment: str
    reviewer: str
    batch_id: int | None


class LatestAnswers:
    """The newest answers on boxes; `app.review` alone adds to them."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def of(self, box_ids: Iterable[int]) -> dict[int, LatestReview]:
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

    def last_id(self, dataset_id: int) -> int:
        """The number of the newest answer in a dataset; 0 if there is none."""
        rows = (
            select(func.max(Review.id))
            .join(Decision, Decision.box_id == Review.box_id)
            .where(Decision.dataset_id == dataset_id)
        )
        return self._session.scalar(rows) or 0

    def newest_id(self) -> int:
        """The number of the newest answer of all datasets; 0 if there is none."""
        return self._session.scalar(select(func.max(Review.id))) or 0

    def boxes_after(self, review_id: int) -> IntArray:
        """The box of each answer after this one, of all datasets."""
        # Not distinct: SQLite would read all answers in the order of their boxes.
        rows = select(Review.box_id).where(Review.id > review_id)
        return np.fromiter(self._session.scalars(rows), np.int64)

    def reviewers_of(self, dataset_id: int, key: str) -> dict[str, int]:
        """How many answers each person gave on a frame, in all of its revisions."""
        rows = (
            select(Review.reviewer, func.count())
            .join(Box, Box.id == Review.box_id)
            .join(Frame, Frame.id == Box.frame_id)
            .where(Frame.dataset_id == dataset_id, Frame.key == key)
            .group_by(Review.reviewer)
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}
