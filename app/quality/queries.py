"""SQL of people's answers, joined with the decisions on the same boxes."""

from __future__ import annotations

from typing import NamedTuple

from sqlalchemy import ColumnElement, select

from app.boxes.filter import BoxProbes
from app.catalog.datasets import DatasetRepository
from app.db.base import Repository
from app.db.tables import Decision, Review, ReviewBatch
from app.verdicts import REVIEW_STATES


class AnsweredBox(NamedTuple):
    """A box with the latest answer on it: what it says, and its id."""

    box_id: int
    review: str | None
    answer_id: int


class DrawnBox(NamedTuple):
    """An answer on a box of the random order: its id, and how the queue chose it."""

    answer_id: int
    box_id: int
    chosen_from: str | None
    probability: float | None


class StoredAnswer(NamedTuple):
    """One answer of one person."""

    box_id: int
    revision: int
    reviewer: str
    verdict: str
    batch_id: int | None
    undoes: int | None


class AnswerRepository(Repository):
    """Reads `reviews` together with `decisions`."""

    def answered(self, dataset_id: int) -> list[AnsweredBox]:
        """Boxes with an answer that was not cleared, and the latest of each."""
        is_latest = Review.revision == Decision.revision
        rows = (
            select(Decision.box_id, Decision.review, Review.id)
            .join(Review, (Review.box_id == Decision.box_id) & is_latest)
            .where(Decision.dataset_id == dataset_id, REVIEW_STATES["any"].condition())
        )
        return [AnsweredBox(*row) for row in self._session.execute(rows)]

    def drawn(self, dataset_id: int) -> list[DrawnBox]:
        """All answers, also earlier ones, on boxes that came by the random order."""
        rows = (
            select(Review.id, Review.box_id, Review.chosen_from, Review.probability)
            .join(Decision, Decision.box_id == Review.box_id)
            .where(*self._of_dataset(dataset_id), Review.probability.is_not(None))
        )
        return [DrawnBox(*row) for row in self._session.execute(rows)]

    def answers(self, dataset_id: int) -> list[StoredAnswer]:
        """All answers on the boxes of a dataset, by box, newest first.

        Also on boxes without an answer now: that somebody has cleared a box's answer
        does not change the answers of others.
        """
        columns = [getattr(Review, name) for name in StoredAnswer._fields]
        rows = (
            select(*columns)
            .join(Decision, Decision.box_id == Review.box_id)
            .where(*self._of_dataset(dataset_id))
            .order_by(Review.box_id, Review.revision.desc())
        )
        return [StoredAnswer._make(row) for row in self._session.execute(rows)]

    def _of_dataset(self, dataset_id: int) -> tuple[ColumnElement[bool], ...]:
        """Conditions: an answer, joined with its box, is on a box of the dataset."""
        class_ids = DatasetRepository(self._session).classes(dataset_id).values()
        span = BoxProbes(self._session).span(dataset_id, class_ids) or (0, 0)
        # By the answers, not by the index of the dataset's boxes (`+ 0`), most of which
        # have no answer.
        return Review.box_id.between(*span), Decision.dataset_id + 0 == dataset_id

    def undone_batches(self, dataset_id: int) -> set[int]:
        """Batches that were undone, and those that undid them."""
        rows = select(ReviewBatch.id, ReviewBatch.undoes_id).where(
            ReviewBatch.dataset_id == dataset_id, ReviewBatch.undoes_id.is_not(None)
        )
        return {batch_id for row in self._session.execute(rows) for batch_id in row}
