"""SQL of answers, of bulk answers and of claims.

`ReviewRepository` stores an answer on one box or its undo (`answer_box`), a bulk answer
(`answer_boxes`), its undo (`restore_answers`), and answers that are carried over to a
new frame (`carry_over`). Each of them

1. inserts rows of `reviews`, with the next revision of their box,
2. ends the claims on these boxes (a new frame has none),
3. calls `copy_answers` or `copy_batch` of `app.boxes.current`, which update the boxes'
   decisions.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import Final, NamedTuple, TypeAlias

from sqlalchemy import (
    CTE,
    ColumnElement,
    Double,
    Integer,
    Row,
    Select,
    String,
    Text,
    bindparam,
    delete,
    exists,
    func,
    literal,
    select,
    update,
)
from sqlalchemy.orm import aliased

from app.boxes.current import copy_answers, copy_batch
from app.boxes.queries import LatestReview
from app.catalog.datasets import is_deleted, is_there
from app.catalog.frames import current_in
from app.db.base import Key, Repository, UtcDateTime, existing, insert_row
from app.db.bulk import chunks, insert_into, insert_rows
from app.db.tables import Box, Claim, Dataset, Decision, Frame, Review, ReviewBatch, Run
from app.errors import NotFound
from unghost.wire.boxes import QueueIn


class CurrentBox(NamedTuple):
    """A current box: the reason of its decision, and its latest answer.

    `review` is None if the box has no answer, or if the latest one cleared it.
    """

    box_id: int
    dataset_id: int
    reason: int
    review: str | None
    revision: int


class NewAnswer(NamedTuple):
    """What a person says of one box of a dataset, or of many with a `batch_id`.

    `undoes` is the revision of the answer that it undoes.
    """

    dataset_id: int
    verdict: str
    comment: str
    reviewer: str
    created_at: datetime
    batch_id: int | None = None
    undoes: int | None = None
    imported_by: str | None = None
    looked_ms: int | None = None


class SeenBoxes(NamedTuple):
    """Boxes that all had the same revision when a person saw them."""

    box_ids: Sequence[int]
    revision: int


_Answers: TypeAlias = (
    "Select[int, int, str, str, str, int | None, int | None, datetime, str | None, "
    "int | None, str | None, str | None, float | None]"
)
"""Answers to be inserted; `_COLUMNS` names their columns."""
_COLUMNS: Final = (
    *("box_id", "revision", "verdict", "comment"),
    *("reviewer", "batch_id", "undoes", "created_at", "imported_by"),
    *("looked_ms", "chosen_by", "chosen_from", "probability"),
)
"""Columns of `reviews`, in the order in which `_next_answers` selects them."""
_UNIQUE: Final = ("box_id", "revision")
_STATE: Final = (
    *(Decision.box_id, Decision.dataset_id),
    *(Decision.reason, Decision.review, Decision.revision),
)
_END_CLAIM: Final = delete(Claim).where(Claim.box_id == bindparam("box"))
_END_CLAIMS_OF_BATCH: Final = delete(Claim).where(
    Claim.box_id.in_(select(Review.box_id).where(Review.batch_id == bindparam("batch")))
)


def _next_answers(
    box_ids: Sequence[int],
    revision: int,
    answer: NewAnswer,
    content: tuple[ColumnElement[str], ColumnElement[str]] | None = None,
) -> _Answers:
    """A SELECT that gives the next answer on each of these boxes.

    Boxes at another revision are left out: they were answered meanwhile.
    `content` is verdict and comment, if they differ from box to box. An answer on one
    box keeps how the queue chose the box for its author, who has a claim on it then.
    """
    verdict, comment = content or (literal(answer.verdict), literal(answer.comment))
    is_chosen = (answer.batch_id, answer.undoes, answer.imported_by) == (None,) * 3
    choice = (
        (Claim.chosen_by, Claim.chosen_from, Claim.probability)
        if is_chosen
        else (literal(None, String()), literal(None, Text()), literal(None, Double()))
    )
    rows = select(
        Decision.box_id,
        Decision.revision + 1,
        verdict,
        comment,
        literal(answer.reviewer),
        literal(answer.batch_id, Key),
        literal(answer.undoes, Integer()),
        literal(answer.created_at, UtcDateTime()),
        literal(answer.imported_by, String()),
        literal(answer.looked_ms, Integer()),
        *choice,
    ).where(
        Decision.box_id.in_(box_ids),
        _of(answer.dataset_id),
        Decision.revision == revision,
    )
    claimed = (Claim.box_id == Decision.box_id) & (Claim.reviewer == answer.reviewer)
    return rows.outerjoin(Claim, claimed) if is_chosen else rows


def _of(dataset_id: int) -> ColumnElement[bool]:
    # Written with `+ 0` so that the boxes are looked up by their ids alone, and not
    # by an index on the dataset.
    return Decision.dataset_id + 0 == dataset_id


class ReviewRepository(Repository):
    """Rows of `reviews`."""

    def has_answered_beyond(
        self, dataset_id: int, reviewer: str, box_ids: Collection[int]
    ) -> bool:
        """Whether a person has answered a box of a dataset that is not one of these."""
        theirs = (
            select(Review.id)
            .join(Decision, Decision.box_id == Review.box_id)
            .where(Decision.dataset_id == dataset_id, Review.reviewer == reviewer)
            .where(Review.box_id.not_in(box_ids))
        )
        return bool(self._session.scalar(select(exists(theirs))))

    def state(self, box_id: int) -> CurrentBox:
        """The current state of a box; raises NotFound if the box is not current."""
        rows = select(*_STATE).where(Decision.box_id == box_id)
        there = rows.join(Dataset, Dataset.id == Decision.dataset_id).where(is_there())
        return CurrentBox(
            *existing(self._session.execute(there).first(), "box", box_id)
        )

    def answer_box(self, box_id: int, seen_revision: int, answer: NewAnswer) -> bool:
        """Store an answer on a box, if it still has the seen revision; else False.

        The revision is compared by the INSERT itself (`_next_answers`), so of two
        people who answer the box at the same time, only one is stored.
        """
        rows = self._insert(_next_answers([box_id], seen_revision, answer))
        if rows == 0:
            return False
        self.end_claim(box_id)
        copy_answers(self._session, [box_id])
        return True

    def boxes_of(
        self, dataset_id: int, frames: Collection[str], boxes: Collection[str]
    ) -> dict[tuple[str, str], int]:
        """Current boxes by the key of their frame and their id in it."""
        rows = (
            select(Frame.key, Box.source_id, Box.id)
            .join(Box, Box.frame_id == Frame.id)
            .where(*current_in(dataset_id))
            .where(Frame.key.in_(frames), Box.source_id.in_(boxes))
        )
        return {(key, box): box_id for key, box, box_id in self._session.execute(rows)}

    def end_claim(self, box_id: int) -> None:
        """Let the queue give a box to others again."""
        self._session.connection().execute(_END_CLAIM, {"box": box_id})

    def same_answer(self, box: CurrentBox, answer: NewAnswer) -> Review | None:
        """The latest answer on a box, if the same person gave the same one alone."""
        if box.revision == 0 or (box.review or "clear") != answer.verdict:
            return None
        latest = self.at(box.box_id, box.revision)
        if latest is None or latest.undoes is not None or latest.batch_id is not None:
            return None
        is_same = (latest.reviewer, latest.comment) == (answer.reviewer, answer.comment)
        return latest if is_same else None

    def repeats(
        self, boxes: Iterable[SeenBoxes], verdict: str, comment: str, reviewer: str
    ) -> bool:
        """Whether the latest answer on each of these boxes is this one of this person.

        Not if there are no boxes, nor if it is an undo that has repeated the answer.
        """
        number = 0
        for seen in boxes:
            for chunk in chunks(seen.box_ids):
                rows = select(func.count()).where(
                    *(Review.box_id.in_(chunk), Review.revision == seen.revision),
                    *(Review.verdict == verdict, Review.comment == comment),
                    *(Review.reviewer == reviewer, Review.undoes.is_(None)),
                )
                if self._session.scalar(rows) != len(chunk):
                    return False
                number += len(chunk)
        return number > 0

    def full_box(self, box_ids: Sequence[int], reviewer: str, most: int) -> int | None:
        """The first of these boxes on which a person has so many answers."""
        for chunk in chunks(box_ids):
            rows = (
                select(Review.box_id)
                .where(Review.box_id.in_(chunk), Review.reviewer == reviewer)
                .group_by(Review.box_id)
                .having(func.count() >= most)
                .order_by(Review.box_id)
                .limit(1)
            )
            box_id = self._session.scalar(rows)
            if box_id is not None:
                return box_id
        return None

    def _insert(self, answers: _Answers) -> int:
        """Insert what the SELECT gives into `reviews`; how many rows that were."""
        statement = insert_into(self._session, Review).from_select(_COLUMNS, answers)
        # Even if `decisions` were wrong, no revision of a box is stored twice.
        unique = statement.on_conflict_do_nothing(index_elements=_UNIQUE)
        counted = unique.execution_options(preserve_rowcount=True)
        stored: int = self._session.connection().execute(counted).rowcount
        return stored

    def states(self, dataset_id: int, box_ids: Iterable[int]) -> Iterator[CurrentBox]:
        """The state of each given box that is a current box of the dataset."""
        for chunk in chunks(box_ids):
            rows = select(*_STATE).where(Decision.box_id.in_(chunk), _of(dataset_id))
            for row in self._session.execute(rows):
                yield CurrentBox(*row)

    def answer_boxes(
        self, batch: ReviewBatch, comment: str, boxes: Iterable[SeenBoxes]
    ) -> int:
        """Store a bulk answer on the boxes that still have the seen revision; how many.

        `batch` is its row: its verdict, who gives it, and when.
        """
        answer = _answer_of(batch, comment)
        stored = sum(
            self._insert(_next_answers(chunk, seen.revision, answer))
            for seen in boxes
            for chunk in chunks(seen.box_ids)
        )
        if stored:
            self._make_latest(batch)
        return stored

    def restore_answers(
        self, undo: ReviewBatch, boxes: Iterable[tuple[int, SeenBoxes]]
    ) -> int:
        """Undo a bulk answer on the boxes that still have their revision; how many.

        `boxes` are those of `ReviewBatches.undoable`. The answer before the bulk answer
        is repeated on each box. If there was none, `clear` is stored, which is the
        verdict of `undo`, the row of the undo.
        """
        cleared, earlier = _answer_of(undo), aliased(Review)
        content = (
            func.coalesce(earlier.verdict, cleared.verdict),
            func.coalesce(earlier.comment, cleared.comment),
        )
        stored = 0
        for answered, seen in boxes:
            answer = cleared._replace(undoes=answered)
            is_before = earlier.revision == answered - 1
            is_earlier = (earlier.box_id == Decision.box_id) & is_before
            for chunk in chunks(seen.box_ids):
                rows = _next_answers(chunk, seen.revision, answer, content)
                stored += self._insert(rows.outerjoin(earlier, is_earlier))
        if stored:
            self._make_latest(undo)
        return stored

    def _make_latest(self, batch: ReviewBatch) -> None:
        """End the claims on the boxes of a bulk answer, and update their decisions.

        Its boxes, maybe a hundred thousand, are selected by its id.
        """
        self._session.connection().execute(_END_CLAIMS_OF_BATCH, {"batch": batch.id})
        copy_batch(self._session, batch.id)

    def carry_over(self, answers: Mapping[int, LatestReview]) -> None:
        """Insert answers on boxes of a new frame, which have no claims.

        The keys are the boxes of the former frame whose answers these are.
        """
        rows = [
            {**answer._asdict(), "carried_from": former}
            for former, answer in answers.items()
        ]
        insert_rows(self._session, Review, rows)
        copy_answers(self._session, [answer.box_id for answer in answers.values()])

    def newest_on_box(self, box_id: int, up_to: int, limit: int) -> list[Review]:
        """The newest answers on a box up to a revision, newest first."""
        rows = select(Review).where(Review.box_id == box_id, Review.revision <= up_to)
        rows = rows.order_by(Review.revision.desc()).limit(limit)
        return list(self._session.scalars(rows))

    def answers_before(self, box_id: int, run: Run) -> int:
        """How many of a box's answers existed when a run was done."""
        on_box = Review.box_id == box_id
        if run.last_review_id is not None:
            is_before = Review.id <= run.last_review_id
            rows = select(Review.revision).where(on_box, is_before)
            rows = rows.order_by(Review.revision.desc()).limit(1)
        else:  # a run of an earlier version has only its time
            at = run.finished_at or run.created_at
            rows = select(func.count()).where(on_box, Review.created_at <= at)
        return self._session.scalar(rows) or 0

    def at(self, box_id: int, revision: int) -> Review | None:
        """The answer that gave a box this revision; None if there is none."""
        rows = select(Review).where(Review.box_id == box_id)
        return self._session.scalar(rows.where(Review.revision == revision))

    def author(self, box_id: int, revision: int) -> str:
        """Who gave an answer; of one that an undo has repeated, who gave that one."""
        undoes: int | None = revision + 1
        while undoes is not None and undoes > 1:
            rows = select(Review.reviewer, Review.undoes).where(
                Review.box_id == box_id, Review.revision == undoes - 1
            )
            reviewer, undoes = self._session.execute(rows).one()
        return reviewer

    def is_in_force(self, answer: Review) -> bool:
        """Whether no answer followed this one, or all that followed were undone."""
        standing = _standing(Review.id == answer.id)
        rows = select(standing).where(standing.c.revision == standing.c.answered)
        return self._session.execute(rows).first() is not None

    def ever_answered(self, frame_id: int) -> list[tuple[int, str, int]]:
        """Boxes of a frame that have, or had, an answer: id, source id and class id."""
        rows = (
            select(Box.id, Box.source_id, Box.class_id)
            .where(Box.frame_id == frame_id)
            .where(exists().where(Review.box_id == Box.id))
            .order_by(Box.id)
        )
        return [(row[0], row[1], row[2]) for row in self._session.execute(rows)]

    def _of_boxes(self, box_ids: Sequence[int]) -> Iterable[_AnswerRow]:
        """Answers on these boxes, by box, the newest first.

        Of each: box, revision, reviewer, verdict, and the columns `undoes` and
        `carried_from`.
        """
        of_answer = (Review.revision, Review.reviewer, Review.verdict, Review.undoes)
        rows = (
            select(Review.box_id, *of_answer, Review.carried_from)
            .where(Review.box_id.in_(box_ids))
            .order_by(Review.box_id, Review.revision.desc())
        )
        return self._session.execute(rows)

    def answers_in_force(self, box_ids: Iterable[int]) -> list[tuple[int, str]]:
        """Each box with each person whose last answer on it stands, by box.

        Only these people or an admin may remove these answers.

        The last such answer of each person on a box counts, regardless of later answers
        by others, unless it removed their answer (`clear`). Answers on the same box in
        earlier revisions of the frame count too.
        """
        last: dict[tuple[int, str], str] = {}
        newest_of = {box_id: box_id for box_id in box_ids}
        while newest_of:
            before: dict[int, int] = {}
            for chunk in chunks(newest_of):
                answers = _without_undone(self._of_boxes(chunk))
                for box_id, who, verdict, origin in answers:
                    last.setdefault((newest_of[box_id], who), verdict)
                    if origin is not None:
                        before[origin] = newest_of[box_id]
            newest_of = before
        return sorted(key for key, verdict in last.items() if verdict != "clear")


_AnswerRow: TypeAlias = "Row[int, int, str, str, int | None, int | None]"


def _without_undone(
    answers: Iterable[_AnswerRow],
) -> Iterator[tuple[int, str, str, int | None]]:
    """The answers that their authors have not undone: box, author, verdict, origin.

    An undo by somebody else leaves an answer. For one that was carried over and that
    its author has undone, there is `clear`: it ends the answer on the earlier box.

    `answers` are those of some boxes as `ReviewRepository._of_boxes` gives them: an
    undo comes before the answer that it undoes. The origin of an answer that was
    carried over is the box in an earlier revision of the frame.
    """
    undone_by: dict[tuple[int, int], str] = {}
    for box_id, revision, who, verdict, undoes, origin in answers:
        undoer = undone_by.get((box_id, revision))
        if undoes is not None:
            if undoer is None:  # an undo that was undone has no effect
                undone_by[box_id, undoes] = who
        elif undoer != who:
            yield box_id, who, verdict, origin
        elif origin is not None:  # undone, and so is the answer on the earlier box
            yield box_id, who, "clear", origin


def _answer_of(batch: ReviewBatch, comment: str = "") -> NewAnswer:
    by, at = batch.reviewer, batch.created_at
    return NewAnswer(batch.dataset_id, batch.verdict, comment, by, at, batch.id)


class ReviewBatches(Repository):
    """Rows of `review_batches`, and the answers that belong to them."""

    def add(
        self,
        dataset_id: int,
        verdict: str,
        reviewer: str,
        *,
        looked_at: int | None = None,
        undoes_id: int | None = None,
    ) -> ReviewBatch:
        """Insert a bulk answer, or with `undoes_id` the undo of one."""
        batch = ReviewBatch(
            dataset_id=dataset_id,
            verdict=verdict,
            reviewer=reviewer,
            looked_at=looked_at,
            undoes_id=undoes_id,
        )
        return insert_row(self._session, batch)

    def with_id(self, batch_id: int) -> ReviewBatch:
        """A batch; raises NotFound."""
        batch = self._session.get(ReviewBatch, batch_id)
        if batch is None or is_deleted(self._session, batch.dataset_id):
            raise NotFound("review batch", batch_id)
        return batch

    def is_undone(self, batch_id: int) -> bool:
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

    def undoable(self, batch_id: int) -> list[tuple[int, SeenBoxes]]:
        """The boxes on which a batch is still in force, so that it can be undone.

        No answer followed it, or all that followed were undone. They are grouped by the
        revision that the batch gave them, which comes first, and by that of now.
        """
        standing = _standing(Review.batch_id == batch_id)
        rows = (
            select(standing.c.box_id, standing.c.answered, Decision.revision)
            .join(Decision, Decision.box_id == standing.c.box_id)
            .where(standing.c.revision == standing.c.answered)
        )
        alike: dict[tuple[int, int], list[int]] = defaultdict(list)
        for box_id, answered, revision in self._session.execute(rows):
            alike[answered, revision].append(box_id)
        return [
            (answered, SeenBoxes(ids, revision))
            for (answered, revision), ids in alike.items()
        ]


def _standing(answers: ColumnElement[bool]) -> CTE:
    """Which of these answers are in force: those with a row `revision == answered`.

    Each answer has one or more rows; `answered` is its revision in all of them. In the
    first row, `revision` is the latest revision of the box. If that is an undo of
    revision 5, the box has its answer of revision 4 again, and there is a second row
    with `revision` 4; and so on. So several answers on a box can be undone, the newest
    first.
    """
    standing = (
        select(
            Review.box_id,
            Review.revision.label("answered"),
            Decision.revision.label("revision"),
        )
        .join(Decision, Decision.box_id == Review.box_id)
        .where(answers)
        .cte("standing", recursive=True)
    )
    undo = aliased(Review)
    of_latest = undo.revision == standing.c.revision
    undone = (undo.box_id == standing.c.box_id) & of_latest & undo.undoes.is_not(None)
    before = select(standing.c.box_id, standing.c.answered, undo.undoes - 1)
    return standing.union_all(before.join(undo, undone))


class ClaimRepository(Repository):
    """Rows of `claims`; expired ones have no effect."""

    def forget_expired(self, dataset_id: int, now: datetime) -> None:
        rows = delete(Claim).where(Claim.dataset_id == dataset_id)
        self._session.execute(rows.where(Claim.expires_at <= now))

    def of_dataset(self, dataset_id: int) -> dict[int, str]:
        """Reviewer by box of all claims of a dataset, the newest first."""
        rows = select(Claim.box_id, Claim.reviewer)
        claims = rows.where(Claim.dataset_id == dataset_id)
        newest_first = claims.order_by(Claim.expires_at.desc())
        return {row[0]: row[1] for row in self._session.execute(newest_first)}

    def end(self, box_ids: Collection[int]) -> None:
        if box_ids:
            self._session.execute(delete(Claim).where(Claim.box_id.in_(box_ids)))

    def renew(self, box_ids: Collection[int], expires_at: datetime) -> None:
        """Extend the claims on boxes, which stay chosen as they were."""
        rows = update(Claim).where(Claim.box_id.in_(box_ids))
        self._session.execute(rows.values(expires_at=expires_at))

    def hold(
        self,
        dataset_id: int,
        reviewer: str,
        expires_at: datetime,
        request: QueueIn,
        probabilities: Mapping[int, float | None],
    ) -> None:
        """Claim boxes, or extend their claims, as they were chosen now, for `request`.

        The probability of a box is that of being among the boxes of the random order up
        to it: None in other orders, and if filters leave out boxes of their classes.
        """
        if not probabilities:
            return
        filters = request.filters.model_dump_json(exclude_none=True, by_alias=True)
        insert = insert_into(self._session, Claim)
        claims = [
            {
                "box_id": box_id,
                "dataset_id": dataset_id,
                "reviewer": reviewer,
                "expires_at": expires_at,
                "chosen_by": request.order,
                "chosen_from": filters,
                "probability": probability,
            }
            for box_id, probability in sorted(probabilities.items())
        ]
        new = {name: insert.excluded[name] for name in claims[0] if name != "box_id"}
        statement = insert.on_conflict_do_update(index_elements=["box_id"], set_=new)
        self._session.connection().execute(statement, claims)
