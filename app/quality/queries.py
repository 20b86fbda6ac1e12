"""SQL of people's answers, joined with the decisions on the same boxes."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import TypeAlias

from sqlalchemy import ColumnElement, Row, select

from app.boxes.filter import BoxProbes
from app.catalog.datasets import DatasetRepository
from app.db.base import Repository
from app.db.tables import Decision, Review, ReviewBatch
from app.verdicts import REVIEW_STATES

AnsweredBox: TypeAlias = "Row[int, str | None, int]"
"""A box (`box_id`), the answer in force on it (`review`), and that answer's `id`."""


class AnswerRepository(Repository):
    """Reads `reviews` together with `decisions`."""

    def answered(self, dataset_id: int) -> list[AnsweredBox]:
        """The boxes with an answer that was not cleared, by id."""
        is_latest = Review.revision == Decision.revision
        rows = (
            select(Decision.box_id, Decision.review, Review.id)
            .join(Review, (Review.box_id == Decision.box_id) & is_latest)
            .where(Decision.dataset_id == dataset_id, REVIEW_STATES["any"].condition())
        )
        return sorted(self._session.execute(rows), key=attrgetter("box_id"))

    def drawn(
        self, dataset_id: int
    ) -> Sequence[Row[int, int, str | None, float | None]]:
        """All answers, also earlier ones, on boxes that came by the random order.

        With how the queue chose the box: `chosen_from` are its filters.
        """
        rows = (
            select(Review.id, Review.box_id, Review.chosen_from, Review.probability)
            .join(Decision, Decision.box_id == Review.box_id)
            .where(*self._of_dataset(dataset_id), Review.probability.is_not(None))
        )
        return self._session.execute(rows).all()

    def answers(
        self, dataset_id: int
    ) -> Sequence[Row[int, int, str, str, int | None, int | None]]:
        """All answers on the boxes of a dataset, by box, newest first.

        `batch_id` is the bulk answer, `undoes` the revision that the answer undoes.
        Also on boxes without an answer now: that somebody has cleared a box's answer
        does not change the answers of others.
        """
        answer = (Review.box_id, Review.revision, Review.reviewer, Review.verdict)
        rows = (
            select(*answer, Review.batch_id, Review.undoes)
            .join(Decision, Decision.box_id == Review.box_id)
            .where(*self._of_dataset(dataset_id))
            .order_by(Review.box_id, Review.revision.desc())
        )
        return self._session.execute(rows).all()

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
        batches = self._session.execute(rows).all()
        return {row.id for row in batches} | {row.undoes_id for row in batches}
