"""Stores a person's answer on one box, and carries answers over to a new frame.

How an answer on a box is stored:

1. `create_review` (`routes`) passes the request to `review_box`.
2. `review_box` reads the current state of the box (`ReviewRepository.state`). This is
   the first SQL statement: it begins the transaction, and waits for its turn.
3. `ReviewRepository.answer_box` inserts the answer as a row of `reviews`, if the box
   still has the revision that the person saw; if not, `review_box` raises StaleReview,
   and the client gets the status 412.
4. `answer_box` then ends the claim on the box and calls `copy_answers`
   (`app.boxes.current`), which copies the answer to the decision of the box and moves
   the box to another tally.
5. `commit_and_respond` (`app.http.transaction`) commits, and only then is the stored
   answer sent back.

Answers on many boxes at once, and their undo, are in `bulk`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from sqlalchemy.orm import Session

from app.boxes.queries import FrameRepository, LatestAnswers, LatestReview
from app.boxes.reader import describe_box
from app.db.base import utc_now
from app.db.engine import once_committed
from app.db.tables import Frame
from app.errors import StaleReview
from app.metrics import REVIEWS
from app.review.queries import Answer, ReviewRepository
from app.verdicts import effective_verdict
from filter_core.annotation.frame import GEOMETRIES
from unghost.wire.boxes import Review, ReviewIn


def review_box(session: Session, box_id: int, given: ReviewIn, reviewer: str) -> Review:
    """Store an answer on a box.

    Raises
    ------
    NotFound
        The box does not exist, or is not current.
    StaleReview
        The box was answered since the person saw it; contains its current decision.
    """
    reviews = ReviewRepository(session)
    box = reviews.state(box_id)
    answer = Answer(box.dataset_id, given.verdict, given.comment, reviewer, utc_now())
    if not reviews.answer_box(box_id, given.seen_revision, answer):
        newest = LatestAnswers(session).of([box_id]).get(box_id)
        raise StaleReview(
            box_id=box_id,
            seen=given.seen_revision,
            found=0 if newest is None else newest.revision,
            current=describe_box(session, box_id),
        )
    once_committed(session, lambda: REVIEWS.labels(answer.verdict).inc())
    return Review(
        box_id=box_id,
        revision=given.seen_revision + 1,
        verdict=given.verdict,
        reviewer=reviewer,
        comment=given.comment,
        created_at=answer.created_at,
        effective_verdict=effective_verdict(box.reason, given.verdict),
    )


class NewBox(NamedTuple):
    """A box of a new revision of a frame; `raw` is the box as it was sent."""

    id: int
    source_id: str
    class_id: int
    raw: Mapping[str, object]


def carry_reviews(
    session: Session, old: Frame, boxes: Iterable[NewBox]
) -> tuple[list[LatestReview], Counter[str]]:
    """Repeat the latest answers on boxes whose class and geometry are the same.

    Returns
    -------
    carried : list of LatestReview
        The repeated answers, each the first on its new box.
    set_aside : Counter of str
        How many answers are dropped, by reviewer: their boxes no longer exist, have
        changed, or have no answer in force. Answers that another person cleared or
        replaced, in any revision, count: otherwise people could remove others' answers
        by clearing them first. Answers that their author has undone do not count.
    """
    reviews = ReviewRepository(session)
    answered = reviews.once_answered(old.id)
    if not answered:
        return [], Counter()
    latest = LatestAnswers(session).of(box_id for box_id, _, _ in answered)
    new = {box.source_id: box for box in boxes}
    annotation = FrameRepository(session).with_id(old.id, annotation=True).annotation
    carried: dict[int, LatestReview] = {}
    left = []
    for old_id, source_id, class_id in answered:
        review, box = latest[old_id], new.get(source_id)
        raw = annotation["boxes"][old_id - old.first_box_id]
        if (
            box is None
            or review.verdict == "clear"
            or class_id != box.class_id
            or _geometry(raw) != _geometry(box.raw)
        ):
            left.append(old_id)
            continue
        carried[old_id] = review._replace(box_id=box.id, revision=1, batch_id=None)
    if carried:
        reviews.carry_over(carried)
    return list(carried.values()), reviews.meant_by(left)


def _geometry(raw: Mapping[str, object]) -> dict[str, object]:
    return {key: raw[key] for key in GEOMETRIES if key in raw}
