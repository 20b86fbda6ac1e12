"""Answers of people: on one box, on many at once, and taken back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.engine import once_committed
from app.db.tables import Dataset, ReviewBatch
from app.errors import Conflict, NotFound, StaleReview, TooLarge, Unprocessable
from app.metrics import REVIEWS
from app.repositories.claims import ClaimRepository
from app.repositories.decisions import CurrentRow, DecisionRepository
from app.repositories.review_batches import UNANSWERED, ReviewBatches, SeenBoxes
from app.repositories.reviews import ReviewRepository
from app.repositories.tallies import TallyKey, TallyRepository
from app.security import Principal
from app.services.others_answers import require_own
from filter_core.types import Reason


@dataclass(frozen=True)
class Answer:
    """What a person says of a box, and who."""

    verdict: str
    comment: str
    reviewer: str


@dataclass(frozen=True)
class StoredReview:
    """An answer as it is stored."""

    row: dict[str, object]
    effective_verdict: str


def effective_verdict(reason: int, review: str | None) -> str:
    """A person's keep or reject counts; without one, the filter's verdict."""
    if review == "keep":
        return "kept"
    if review == "reject":
        return "rejected"
    return Reason(reason).verdict.value


def review_box(
    session: Session, box_id: int, answer: Answer, seen_revision: int
) -> StoredReview:
    """Add one answer; StaleReview if someone answered since it was seen."""
    current = DecisionRepository(session).rows([box_id]).get(box_id)
    if current is None:
        raise NotFound("box", box_id)
    if current.revision != seen_revision:
        raise StaleReview(box_id=box_id, seen=seen_revision, found=current.revision)
    dataset_id = DecisionRepository(session).dataset_of(box_id)
    (row,) = _store(session, dataset_id, [(current, answer)], batch_id=None)
    once_committed(session, partial(REVIEWS.add, 1, answer.verdict))
    review = None if answer.verdict == "clear" else answer.verdict
    return StoredReview(row, effective_verdict(current.reason, review))


@dataclass(frozen=True)
class StoredBatch:
    """One answer on many boxes as it is stored, and the boxes that were left alone.

    `stale` were answered since they were seen, `skipped` are gone or of another
    dataset.
    """

    batch: ReviewBatch
    answered: int
    skipped: list[int]
    stale: list[int]


def review_many(
    session: Session, dataset: Dataset, boxes: Sequence[SeenBoxes], answer: Answer
) -> StoredBatch:
    """Add one answer to many boxes, each once, where it is as somebody saw it."""
    batches = ReviewBatches(session)
    batch = batches.add(
        ReviewBatch(
            dataset_id=dataset.id, verdict=answer.verdict, reviewer=answer.reviewer
        )
    )
    answered = batches.answer(batch, boxes, answer.comment)
    once_committed(session, partial(REVIEWS.add, answered, answer.verdict))
    chosen = [box_id for seen in boxes for box_id in seen.box_ids]
    if answered == len(chosen):
        return StoredBatch(batch, answered, [], [])
    left = sorted(set(chosen).difference(batches.boxes(batch.id)))
    stale = DecisionRepository(session).ids_in_dataset(left, dataset.id)
    gone = [box_id for box_id in left if box_id not in stale]
    return StoredBatch(batch, answered, gone, sorted(stale))


def listed_boxes(
    ids: Sequence[int], seen: Sequence[int] | None, limit: int
) -> list[SeenBoxes]:
    """The boxes that a person listed, each once, by the revision that was seen.

    Parameters
    ----------
    ids : sequence of int
    seen : sequence of int, or None
        The revision of each box, in the order of `ids`. None: nothing is known of
        what the person saw, so only boxes without an answer are to be taken.

    Raises
    ------
    Unprocessable
        There are more or fewer revisions than boxes, or two of one box.
    TooLarge
        More boxes than one act may answer.
    """
    revisions = [UNANSWERED] * len(ids) if seen is None else seen
    if len(revisions) != len(ids):
        raise Unprocessable(
            f"seen_revisions: expected one for each of {len(ids)} box_ids, "
            f"found {len(revisions)}"
        )
    revision_of: dict[int, int] = {}
    for box_id, revision in zip(ids, revisions, strict=True):
        if revision_of.setdefault(box_id, revision) != revision:
            raise Unprocessable(
                f"seen_revisions: expected one revision of box {box_id}, found "
                f"{revision_of[box_id]} and {revision}"
            )
    if len(revision_of) > limit:
        raise TooLarge(
            f"{len(revision_of)} boxes, one bulk review changes at most {limit}"
        )
    alike: dict[int, list[int]] = {}
    for box_id, revision in revision_of.items():
        alike.setdefault(revision, []).append(box_id)
    return [SeenBoxes(box_ids, revision) for revision, box_ids in alike.items()]


def undo_batch(
    session: Session, batch_id: int, by: Principal
) -> tuple[ReviewBatch, int, list[int]]:
    """Say again what was said before a batch, but where someone spoke since.

    Raises
    ------
    NotFound
        There is no such batch.
    Forbidden
        It is another person's, and this is no admin.
    Conflict
        It was undone already.
    """
    batches = ReviewBatches(session)
    batch = batches.with_id(batch_id)
    answers = {batch.reviewer: batches.size(batch_id)}
    require_own(by, answers, f"undoing batch {batch_id}")
    if batches.is_undone(batch_id):
        raise Conflict(f"batch {batch_id} was undone already", code="already_undone")
    undo = batches.add(
        ReviewBatch(
            dataset_id=batch.dataset_id,
            verdict="clear",
            undoes_id=batch_id,
            reviewer=by.name,
        )
    )
    undone = batches.answer_as_before(undo, batch)
    once_committed(session, partial(REVIEWS.add, undone, "undo"))
    skipped = set(batches.boxes(batch_id)).difference(batches.boxes(undo.id))
    return undo, undone, sorted(skipped)


def _store(
    session: Session,
    dataset_id: int,
    answers: Sequence[tuple[CurrentRow, Answer]],
    *,
    batch_id: int | None,
) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    changes: dict[TallyKey, int] = {}
    for current, answer in answers:
        rows.append(
            {
                "box_id": current.box_id,
                "revision": current.revision + 1,
                "verdict": answer.verdict,
                "comment": answer.comment,
                "reviewer": answer.reviewer,
                "batch_id": batch_id,
                "created_at": utc_now(),
            }
        )
        review = "" if answer.verdict == "clear" else answer.verdict
        for said, change in ((current.review or "", -1), (review, 1)):
            key = TallyKey(current.class_id, current.reason, current.toss_up, said)
            changes[key] = changes.get(key, 0) + change
    if rows:
        ReviewRepository(session).add(rows)
        TallyRepository(session).add(dataset_id, changes)
        answered = {current.box_id for current, _ in answers}
        ClaimRepository(session).release(dataset_id, answered)
    return rows
