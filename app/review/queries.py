"""SQL of answers, of acts on many boxes, and of claims."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import (
    CTE,
    ColumnElement,
    Executable,
    Select,
    delete,
    exists,
    func,
    insert,
    literal,
    select,
)
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session, aliased

from app.boxes.current import DecisionRepository, TallyKey, TallyRepository
from app.db.base import UtcDateTime, utc_now
from app.db.bulk import chunks, upsert
from app.db.tables import Box, Claim, Decision, Review, ReviewBatch
from app.errors import LostRace, NotFound
from app.measuring.queries import is_deleted


class ClaimRepository:
    """Rows of `claims`; those that expired are as good as gone."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def forget_expired(self, dataset_id: int, now: datetime) -> None:
        """Delete what holds nobody back any more."""
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
        """Claim boxes, or go on claiming them."""
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

    def release(self, dataset_id: int, box_ids: Collection[int]) -> None:
        """Boxes that were answered: nobody has to be kept from them."""
        # Claims are few, and answers may be a hundred thousand.
        held = select(Claim.box_id).where(Claim.dataset_id == dataset_id)
        answered = set(box_ids).intersection(self._session.scalars(held))
        for chunk in chunks(answered):
            self._session.execute(delete(Claim).where(Claim.box_id.in_(chunk)))


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
        DecisionRepository(self._session).answered_in(batch.id)
        connection = self._session.connection()
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


class AnsweredBox(NamedTuple):
    """A box that has got an answer at some time."""

    id: int
    source_id: str
    class_id: int


def insert_answers(
    session: Session, statement: Executable, rows: Sequence[dict[str, Any]] = ()
) -> None:
    """Insert answers, listed or selected by the statement itself.

    Unique (box, revision) settles a race between two people.

    Raises
    ------
    LostRace
        A box has an answer of this revision already.
    """
    try:
        session.connection().execute(statement, rows or None)
    except IntegrityError as error:
        raise LostRace from error


class ReviewRepository:
    """Rows of `reviews`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def add(self, rows: Sequence[dict[str, Any]]) -> None:
        """Insert answers; LostRace if somebody answered a box at the same moment."""
        insert_answers(self._session, insert(Review), list(rows))
        DecisionRepository(self._session).answered(rows)

    def of_box(self, box_id: int) -> list[Review]:
        """All answers on a box, oldest first."""
        rows = select(Review).where(Review.box_id == box_id).order_by(Review.revision)
        return list(self._session.scalars(rows))

    def answered_boxes(self, frame_id: int) -> list[AnsweredBox]:
        """Boxes of a frame on which somebody ever answered."""
        rows = (
            select(Box.id, Box.source_id, Box.class_id)
            .where(Box.frame_id == frame_id)
            .where(exists().where(Review.box_id == Box.id))
            .order_by(Box.id)
        )
        return [AnsweredBox(*row) for row in self._session.execute(rows)]

    def meant_by(self, box_ids: Iterable[int]) -> Counter[str]:
        """On how many boxes each person has an answer that they did not take back.

        Whatever others said afterwards, and also where a box came from in the revisions
        before: the last thing that each person said of it.
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
