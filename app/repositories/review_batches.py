"""Many answers in one act: written by the database itself, however many there are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from sqlalchemy import (
    CTE,
    ColumnElement,
    Select,
    case,
    delete,
    func,
    insert,
    literal,
    null,
    select,
    update,
)
from sqlalchemy.orm import Session, aliased

from app.db.base import UtcDateTime, utc_now
from app.db.bulk import chunks
from app.db.tables import Claim, Decision, Review, ReviewBatch
from app.errors import NotFound
from app.repositories.datasets import is_deleted
from app.repositories.reviews import insert_answers
from app.repositories.tallies import TallyKey, TallyRepository

COLUMNS = (
    "box_id",
    "revision",
    "verdict",
    "comment",
    "reviewer",
    "batch_id",
    "created_at",
)


class Alike(NamedTuple):
    """Boxes that were alike before an answer, and what the answer is."""

    before: TallyKey
    verdict: str
    boxes: int


class SeenBoxes(NamedTuple):
    """Boxes to answer that have the same revision."""

    box_ids: Sequence[int]
    revision: int


class Standing(NamedTuple):
    """Boxes on which an act stands: nobody spoke since, or what they said is undone.

    `revision` is the boxes' own, `before` that of the answer before the act.
    """

    box_ids: Sequence[int]
    revision: int
    before: int


class BoxState(NamedTuple):
    """What an answer has to know of a box."""

    box_id: int
    revision: int
    is_answered: bool


class ReviewBatches:
    """Rows of `review_batches`, and the answers that belong to them."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def add(self, batch: ReviewBatch) -> ReviewBatch:
        """Insert a batch."""
        self._session.add(batch)
        self._session.flush()
        return batch

    def with_id(self, batch_id: int) -> ReviewBatch:
        """A batch; NotFound."""
        found = self._session.get(ReviewBatch, batch_id)
        if found is None or is_deleted(self._session, found.dataset_id):
            raise NotFound("review batch", batch_id)
        return found

    def is_undone(self, batch_id: int) -> bool:
        """Whether a batch was undone already."""
        rows = select(ReviewBatch.id).where(ReviewBatch.undoes_id == batch_id)
        return self._session.scalar(rows.limit(1)) is not None

    def boxes(self, batch_id: int) -> list[int]:
        """The boxes that a batch answered, in order."""
        rows = select(Review.box_id).where(Review.batch_id == batch_id)
        return list(self._session.scalars(rows.order_by(Review.box_id)))

    def size(self, batch_id: int) -> int:
        """How many answers a batch is made of."""
        rows = select(func.count()).where(Review.batch_id == batch_id)
        return self._session.scalar(rows) or 0

    def states(self, dataset_id: int, box_ids: Iterable[int]) -> Iterator[BoxState]:
        """Those of these boxes that are current boxes of the dataset."""
        for chunk in chunks(box_ids):
            rows = select(
                Decision.box_id, Decision.revision, Decision.review.is_not(None)
            ).where(Decision.box_id.in_(chunk), _of(dataset_id))
            for row in self._session.execute(rows):
                yield BoxState(*row)

    def standing(self, batch_id: int) -> list[Standing]:
        """The boxes on which a batch stands, those alike together."""
        standing = _standing(batch_id)
        rows = (
            select(standing.c.box_id, Decision.revision, standing.c.answered - 1)
            .join(Decision, Decision.box_id == standing.c.box_id)
            .where(standing.c.revision == standing.c.answered)
        )
        alike: dict[tuple[int, int], list[int]] = {}
        for box_id, revision, before in self._session.execute(rows):
            alike.setdefault((revision, before), []).append(box_id)
        return [Standing(ids, *revisions) for revisions, ids in alike.items()]

    def answer(
        self, batch: ReviewBatch, boxes: Iterable[SeenBoxes], comment: str
    ) -> int:
        """Answer boxes of the dataset that are as they were seen; how many."""
        said = literal(batch.verdict), literal(comment)
        for seen in boxes:
            for chunk in chunks(seen.box_ids):
                self._insert(
                    select(
                        Decision.box_id, Decision.revision + 1, *said, *_signed(batch)
                    )
                    .where(Decision.box_id.in_(chunk), _of(batch.dataset_id))
                    .where(Decision.revision == seen.revision)
                )
        return self._apply(batch)

    def answer_as_before(self, batch: ReviewBatch, boxes: Iterable[Standing]) -> int:
        """Say again what was said before, where nobody spoke since; on how many."""
        earlier = aliased(Review)
        said = (
            func.coalesce(earlier.verdict, "clear"),
            func.coalesce(earlier.comment, ""),
        )
        for seen in boxes:
            for chunk in chunks(seen.box_ids):
                self._insert(
                    select(
                        Decision.box_id, Decision.revision + 1, *said, *_signed(batch)
                    )
                    .outerjoin(
                        earlier,
                        (earlier.box_id == Decision.box_id)
                        & (earlier.revision == seen.before),
                    )
                    .where(Decision.box_id.in_(chunk), _of(batch.dataset_id))
                    .where(Decision.revision == seen.revision)
                )
        return self._apply(batch)

    def _insert(self, answers: Select[Any]) -> None:
        statement = insert(Review).from_select(list(COLUMNS), answers)
        insert_answers(self._session, statement)

    def _apply(self, batch: ReviewBatch) -> int:
        """Make the batch's answers the latest ones; how many there are."""
        said = self._said(batch.id)
        answers = select(Review.box_id).where(Review.batch_id == batch.id)
        connection = self._session.connection()
        connection.execute(
            update(Decision)
            .where(Review.batch_id == batch.id, Decision.box_id == Review.box_id)
            .values(
                review=case((Review.verdict == "clear", null()), else_=Review.verdict),
                revision=Review.revision,
            )
        )
        connection.execute(delete(Claim).where(Claim.box_id.in_(answers)))
        TallyRepository(self._session).add(batch.dataset_id, _changes(said))
        return sum(alike.boxes for alike in said)

    def _said(self, batch_id: int) -> list[Alike]:
        """The batch's answers, counted by what they are about."""
        kind = (Decision.class_id, Decision.reason, Decision.toss_up)
        alike = (*kind, func.coalesce(Decision.review, ""), Review.verdict)
        rows = (
            select(*alike, func.count())
            .select_from(Review)
            .join(Decision, Decision.box_id == Review.box_id)
            .where(Review.batch_id == batch_id)
            .group_by(*alike)
        )
        return [
            Alike(TallyKey(row[0], row[1], row[2], row[3]), row[4], row[5])
            for row in self._session.execute(rows)
        ]


def _of(dataset_id: int) -> ColumnElement[bool]:
    # Said so that the boxes are looked up by their ids and nothing else.
    return Decision.dataset_id + 0 == dataset_id


def _standing(batch_id: int) -> CTE:
    """The batch's boxes with every revision of which the latest answer is a repetition.

    An undo says again what was said before, so it stands for the revision before the
    one that it takes back: acts that lie on each other come off one by one.
    """
    standing = (
        select(
            Review.box_id,
            Review.revision.label("answered"),
            Decision.revision.label("revision"),
        )
        .join(Decision, Decision.box_id == Review.box_id)
        .where(Review.batch_id == batch_id)
        .cte("standing", recursive=True)
    )
    said, taken_back = aliased(Review), aliased(Review)
    return standing.union_all(
        select(standing.c.box_id, standing.c.answered, taken_back.revision - 1)
        .select_from(standing)
        .join(
            said,
            (said.box_id == standing.c.box_id) & (said.revision == standing.c.revision),
        )
        .join(ReviewBatch, ReviewBatch.id == said.batch_id)
        .join(
            taken_back,
            (taken_back.box_id == said.box_id)
            # Said so that the box is looked up and not all of the batch.
            & (taken_back.batch_id + 0 == ReviewBatch.undoes_id),
        )
    )


def _signed(batch: ReviewBatch) -> tuple[Any, ...]:
    return (
        literal(batch.reviewer),
        literal(batch.id),
        literal(utc_now(), UtcDateTime()),
    )


def _changes(said: Sequence[Alike]) -> dict[TallyKey, int]:
    """What these answers change in the tallies."""
    changes: dict[TallyKey, int] = {}
    for before, verdict, boxes in said:
        after = before._replace(review="" if verdict == "clear" else verdict)
        changes[before] = changes.get(before, 0) - boxes
        changes[after] = changes.get(after, 0) + boxes
    return changes
