"""SQL of answers, of bulk answers and of claims.

`ReviewRepository` stores answers in three ways: on boxes in the state in which they
were seen (one box or a hundred thousand), as an undo, or carried over to a new frame.
Each inserts rows and then calls `boxes.current.answered` to update the decisions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from datetime import datetime
from typing import Final, NamedTuple, TypeAlias, TypedDict

from sqlalchemy import (
    CTE,
    BindParameter,
    ColumnElement,
    Select,
    bindparam,
    delete,
    exists,
    func,
    literal,
    select,
)
from sqlalchemy.orm import Session, aliased

from app.boxes.current import answered
from app.db.base import Key, UtcDateTime
from app.db.bulk import chunks, insert_rows, upsert
from app.db.tables import Box, Claim, Dataset, Decision, Review, ReviewBatch
from app.errors import NotFound
from app.measuring.queries import is_deleted, is_there


class SeenBoxes(NamedTuple):
    """Boxes to answer, and the revision of all of them when a person saw them."""

    box_ids: Sequence[int]
    revision: int


class StandingBoxes(NamedTuple):
    """Boxes on which a batch is still in force, so that it can be undone on them.

    No answer followed it, or all that followed were undone. `revision` is the boxes'
    current revision, `before` that of the answer before the batch.
    """

    box_ids: Sequence[int]
    revision: int
    before: int


class ReviewedBox(NamedTuple):
    """A box before an answer on it is stored; `review` is the latest answer."""

    box_id: int
    dataset_id: int
    reason: int
    review: str | None
    revision: int


class Signature(NamedTuple):
    """Who answers boxes of a dataset, and when; `batch_id` is set for a bulk answer."""

    dataset_id: int
    reviewer: str
    at: datetime
    batch_id: int | None = None


_Answers: TypeAlias = "Select[int, int, str, str, str, int | None, datetime]"
"""Answers to be inserted; `_COLUMNS` names their columns."""


class AnswerRow(TypedDict):
    """A row of `reviews` to be inserted."""

    box_id: int
    revision: int
    verdict: str
    comment: str
    reviewer: str
    batch_id: int | None
    carried_from: int | None
    created_at: datetime


class AnsweredBox(NamedTuple):
    """A box that has, or had, an answer."""

    id: int
    source_id: str
    class_id: int


class ReviewRepository:
    """Rows of `reviews`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def state(self, box_id: int) -> ReviewedBox:
        """The current state of a box; raises NotFound if the box is not current."""
        rows = select(*_STATE).where(Decision.box_id == box_id)
        there = rows.join(Dataset, Dataset.id == Decision.dataset_id).where(is_there())
        found = self._session.execute(there).first()
        if found is None:
            raise NotFound("box", box_id)
        return ReviewedBox(*found)

    def states(self, dataset_id: int, box_ids: Iterable[int]) -> Iterator[ReviewedBox]:
        """Those of these boxes that are current boxes of the dataset."""
        for chunk in chunks(box_ids):
            rows = select(*_STATE).where(Decision.box_id.in_(chunk), _of(dataset_id))
            for row in self._session.execute(rows):
                yield ReviewedBox(*row)

    def answer(
        self, boxes: Sequence[SeenBoxes], verdict: str, comment: str, by: Signature
    ) -> int:
        """Answer the boxes that still have the seen revision; returns how many."""
        said = literal(verdict), literal(comment)
        stored = sum(
            self._insert(_answers(said, by, chunk, seen.revision))
            for seen in boxes
            for chunk in chunks(seen.box_ids)
        )
        self._make_latest((box_id for seen in boxes for box_id in seen.box_ids), by)
        return stored

    def answer_as_before(self, boxes: Sequence[StandingBoxes], by: Signature) -> int:
        """Repeat the answers before a batch, unless others followed; how many."""
        earlier = aliased(Review)
        said = (
            func.coalesce(earlier.verdict, "clear"),
            func.coalesce(earlier.comment, ""),
        )
        stored = sum(
            self._insert(
                _answers(said, by, chunk, seen.revision).outerjoin(
                    earlier,
                    (earlier.box_id == Decision.box_id)
                    & (earlier.revision == seen.before),
                )
            )
            for seen in boxes
            for chunk in chunks(seen.box_ids)
        )
        self._make_latest((box_id for seen in boxes for box_id in seen.box_ids), by)
        return stored

    def carry_over(self, rows: Sequence[AnswerRow]) -> None:
        """Insert the first answers on new boxes, which have no claims."""
        insert_rows(self._session, Review, rows)
        answered(self._session, [row["box_id"] for row in rows])

    def _insert(self, answers: _Answers) -> int:
        statement = upsert(self._session, Review).from_select(_COLUMNS, answers)
        # Even if `decisions` were wrong, no revision of a box is stored twice.
        unique = statement.on_conflict_do_nothing(index_elements=_UNIQUE)
        told = unique.execution_options(preserve_rowcount=True)
        stored: int = self._session.connection().execute(told).rowcount
        return stored

    def _make_latest(self, box_ids: Iterable[int], by: Signature) -> None:
        """Make the inserted answers the latest ones, and end the claims on their boxes.

        Answers of a bulk answer, maybe a hundred thousand, are selected by its id.
        """
        connection = self._session.connection()
        if by.batch_id is None:
            ids = list(box_ids)
            connection.execute(_END_CLAIMS, {"boxes": ids})
            answered(self._session, ids)
        else:
            connection.execute(_END_CLAIMS_OF_BULK_ANSWER, {"batch": by.batch_id})
            answered(self._session, batch_id=by.batch_id)

    def of_box(self, box_id: int) -> list[Review]:
        """All answers on a box, oldest first."""
        rows = select(Review).where(Review.box_id == box_id).order_by(Review.revision)
        return list(self._session.scalars(rows))

    def answered_boxes(self, frame_id: int) -> list[AnsweredBox]:
        """Boxes of a frame that have, or had, an answer."""
        rows = (
            select(Box.id, Box.source_id, Box.class_id)
            .where(Box.frame_id == frame_id)
            .where(exists().where(Review.box_id == Box.id))
            .order_by(Box.id)
        )
        return [AnsweredBox(*row) for row in self._session.execute(rows)]

    def meant_by(self, box_ids: Iterable[int]) -> Counter[str]:
        """On how many boxes each person has an answer that they did not undo.

        The last answer of each person on a box counts, regardless of later answers by
        others. Answers on the same box in earlier revisions of the frame count too.
        """
        last: dict[tuple[int, str], str] = {}
        newest_of = {box_id: box_id for box_id in box_ids}
        while newest_of:
            before: dict[int, int] = {}
            for chunk in chunks(newest_of):
                rows = (
                    select(
                        Review.box_id,
                        Review.reviewer,
                        Review.verdict,
                        Review.carried_from,
                    )
                    .where(Review.box_id.in_(chunk))
                    .order_by(Review.box_id, Review.revision.desc())
                )
                for box_id, reviewer, verdict, origin in self._session.execute(rows):
                    newest = newest_of[box_id]
                    last.setdefault((newest, reviewer), verdict)
                    if origin is not None:
                        before[origin] = newest
            newest_of = before
        return Counter(who for (_, who), verdict in last.items() if verdict != "clear")


_COLUMNS: Final = (
    *("box_id", "revision", "verdict", "comment"),
    *("reviewer", "batch_id", "created_at"),
)
"""Columns of `reviews`, in the order in which `_answers` selects them."""
_UNIQUE: Final = ("box_id", "revision")
_STATE: Final = (
    *(Decision.box_id, Decision.dataset_id),
    *(Decision.reason, Decision.review, Decision.revision),
)
_END_CLAIMS: Final = delete(Claim).where(
    Claim.box_id.in_(bindparam("boxes", expanding=True))
)
_END_CLAIMS_OF_BULK_ANSWER: Final = delete(Claim).where(
    Claim.box_id.in_(select(Review.box_id).where(Review.batch_id == bindparam("batch")))
)


def _answers(
    said: tuple[ColumnElement[str], ColumnElement[str]],
    by: Signature,
    box_ids: Sequence[int],
    revision: int,
) -> _Answers:
    """The next answer on those of these boxes that still have this revision."""
    verdict, comment = said
    batch: BindParameter[int | None] = literal(by.batch_id, Key)
    return select(
        Decision.box_id,
        Decision.revision + 1,
        verdict,
        comment,
        literal(by.reviewer),
        batch,
        literal(by.at, UtcDateTime()),
    ).where(
        Decision.box_id.in_(box_ids),
        _of(by.dataset_id),
        Decision.revision == revision,
    )


def _of(dataset_id: int) -> ColumnElement[bool]:
    # Written with `+ 0` so that the boxes are looked up by their ids alone, and not
    # by an index on the dataset.
    return Decision.dataset_id + 0 == dataset_id


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
        """A batch; raises NotFound."""
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
        """How many answers a batch has."""
        rows = select(func.count()).where(Review.batch_id == batch_id)
        return self._session.scalar(rows) or 0

    def standing(self, batch_id: int) -> list[StandingBoxes]:
        """The boxes on which a batch is still in force, grouped by their revisions."""
        standing = _standing(batch_id)
        rows = (
            select(standing.c.box_id, Decision.revision, standing.c.answered - 1)
            .join(Decision, Decision.box_id == standing.c.box_id)
            .where(standing.c.revision == standing.c.answered)
        )
        alike: dict[tuple[int, int], list[int]] = {}
        for box_id, revision, before in self._session.execute(rows):
            alike.setdefault((revision, before), []).append(box_id)
        return [StandingBoxes(ids, *revisions) for revisions, ids in alike.items()]


def _standing(batch_id: int) -> CTE:
    """Each box of the batch, with every revision that is equal to its latest answer.

    An undo repeats the answer from before the batch that it undoes, so it is equal to
    that earlier revision. Thus several batches on the same boxes can be undone one by
    one, the newest first.
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
    said, undone = aliased(Review), aliased(Review)
    return standing.union_all(
        select(standing.c.box_id, standing.c.answered, undone.revision - 1)
        .select_from(standing)
        .join(
            said,
            (said.box_id == standing.c.box_id) & (said.revision == standing.c.revision),
        )
        .join(ReviewBatch, ReviewBatch.id == said.batch_id)
        .join(
            undone,
            (undone.box_id == said.box_id)
            # Written with `+ 0` so that the box is looked up, and not all of the batch.
            & (undone.batch_id + 0 == ReviewBatch.undoes_id),
        )
    )


class ClaimRepository:
    """Rows of `claims`; expired ones have no effect."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def forget_expired(self, dataset_id: int, now: datetime) -> None:
        """Delete expired claims."""
        self._session.execute(
            delete(Claim).where(Claim.dataset_id == dataset_id, Claim.expires_at <= now)
        )

    def of_dataset(self, dataset_id: int) -> dict[int, str]:
        """Reviewer by box of all claims of a dataset."""
        rows = select(Claim.box_id, Claim.reviewer).where(
            Claim.dataset_id == dataset_id
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}

    def hold(
        self,
        dataset_id: int,
        box_ids: Collection[int],
        reviewer: str,
        expires_at: datetime,
    ) -> None:
        """Claim boxes, or extend their claims."""
        if not box_ids:
            return
        insert = upsert(self._session, Claim)
        claims = [
            {
                "box_id": box_id,
                "dataset_id": dataset_id,
                "reviewer": reviewer,
                "expires_at": expires_at,
            }
            for box_id in box_ids
        ]
        statement = insert.on_conflict_do_update(
            index_elements=["box_id"],
            set_={
                name: insert.excluded[name]
                for name in ("dataset_id", "reviewer", "expires_at")
            },
        )
        self._session.connection().execute(statement, claims)
