"""SQL of people's answers, joined with the decisions on the same boxes."""

from __future__ import annotations

from typing import NamedTuple

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.boxes.filter import BoxProbes
from app.db.tables import Decision, Review, ReviewBatch
from app.measuring.queries import DatasetRepository
from app.verdicts import REVIEW_STATES


class AnsweredBox(NamedTuple):
    """A current decision that a person confirmed or overruled."""

    box_id: int
    class_id: int
    reason: int
    large: bool
    match_percent: float | None
    distance: float | None
    review: str | None


class StoredAnswer(NamedTuple):
    """One answer of one person."""

    box_id: int
    revision: int
    reviewer: str
    verdict: str
    batch_id: int | None
    undoes: int | None


class AnswerRepository:
    """Reads `reviews` together with `decisions`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def decided(self, dataset_id: int) -> list[AnsweredBox]:
        """Boxes whose latest answer is keep or reject."""
        rows = select(
            Decision.box_id,
            Decision.class_id,
            Decision.reason,
            Decision.large,
            Decision.match_percent,
            Decision.distance,
            Decision.review,
        ).where(Decision.dataset_id == dataset_id, REVIEW_STATES["decided"].condition())
        return [AnsweredBox(*row) for row in self._session.execute(rows)]

    def answers(self, dataset_id: int) -> list[StoredAnswer]:
        """All answers on the boxes of a dataset, by box, newest first.

        Also on boxes without an answer now: that somebody has cleared a box's answer
        does not change the answers of others.
        """
        class_ids = DatasetRepository(self._session).classes(dataset_id).values()
        span = BoxProbes(self._session).span(dataset_id, class_ids)
        if span is None:
            return []
        rows = (
            select(
                *(Review.box_id, Review.revision, Review.reviewer),
                *(Review.verdict, Review.batch_id, Review.undoes),
            )
            .join(Decision, Decision.box_id == Review.box_id)
            # By the answers, not by the index of the dataset's boxes (`+ 0`), most of
            # which have no answer.
            .where(Review.box_id.between(*span), Decision.dataset_id + 0 == dataset_id)
            .order_by(Review.box_id, Review.revision.desc())
        )
        return [StoredAnswer(*row) for row in self._session.execute(rows)]

    def undone_batches(self, dataset_id: int) -> set[int]:
        """Batches that were undone, and those that undid them."""
        rows = select(ReviewBatch.id, ReviewBatch.undoes_id).where(
            ReviewBatch.dataset_id == dataset_id, ReviewBatch.undoes_id.is_not(None)
        )
        return {batch_id for row in self._session.execute(rows) for batch_id in row}
