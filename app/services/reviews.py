"""Answers of people: on one box, on many at once, and taken back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.engine import once_committed
from app.db.tables import Dataset, ReviewBatch
from app.errors import Conflict, CountChanged, NotFound, StaleReview, TooLarge
from app.metrics import REVIEWS
from app.repositories.claims import ClaimRepository
from app.repositories.decisions import CurrentRow, DecisionRepository
from app.repositories.review_batches import ReviewBatches
from app.repositories.reviews import ReviewRepository
from app.repositories.tallies import TallyKey, TallyRepository
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


def review_many(
    session: Session, dataset: Dataset, box_ids: Sequence[int], answer: Answer
) -> tuple[ReviewBatch, int, list[int]]:
    """Add one answer to many boxes: the batch, how many, and those that are gone."""
    batches = ReviewBatches(session)
    batch = batches.add(
        ReviewBatch(
            dataset_id=dataset.id, verdict=answer.verdict, reviewer=answer.reviewer
        )
    )
    chosen = list(dict.fromkeys(box_ids))
    answered = batches.answer(batch, chosen, answer.comment)
    once_committed(session, partial(REVIEWS.add, answered, answer.verdict))
    if answered == len(chosen):
        return batch, answered, []
    found = set(batches.boxes(batch.id))
    return batch, answered, [box_id for box_id in chosen if box_id not in found]


def listed_boxes(ids: Sequence[int], expected: int | None, limit: int) -> list[int]:
    """The boxes that a person listed, each once."""
    chosen = list(dict.fromkeys(ids))
    if expected is not None and expected != len(chosen):
        raise CountChanged("box_ids lists", found=len(chosen), expected=expected)
    if len(chosen) > limit:
        raise TooLarge(f"{len(chosen)} boxes, one bulk review changes at most {limit}")
    return chosen


def undo_batch(
    session: Session, batch_id: int, reviewer: str
) -> tuple[ReviewBatch, int, list[int]]:
    """Say again what was said before a batch, but where someone spoke since."""
    batches = ReviewBatches(session)
    batch = batches.with_id(batch_id)
    if batches.is_undone(batch_id):
        raise Conflict(f"batch {batch_id} was undone already", code="already_undone")
    undo = batches.add(
        ReviewBatch(
            dataset_id=batch.dataset_id,
            verdict="clear",
            undoes_id=batch_id,
            reviewer=reviewer,
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
