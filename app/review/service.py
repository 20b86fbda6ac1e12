"""Stores a person's answer on one box.

1. `create_review` (`routes`) passes the request to `review_box`.
2. `review_box` reads the current state of the box (`ReviewRepository.state`). Before
   this first SQL statement runs, `app.http.transaction` begins the transaction, waits
   until no other one writes, and takes the idempotency key of the request.
3. `ReviewRepository.answer_box` inserts the answer as a row of `reviews`, if the box
   still has the revision that the person saw; if not, `review_box` raises StaleReview,
   and the client gets the status 412.
4. `answer_box` then ends the claim on the box (the queue reserves a box for one person)
   and calls `copy_answers` (`app.boxes.current`), which copies the answer to the
   decision of the box and moves the box to another tally.
5. `commit_and_respond` (`app.http.transaction`) commits, and only then is the stored
   answer sent back.

Answers on many boxes at once, and their undo, are in `bulk`.
"""

from __future__ import annotations

from sqlalchemy.orm import Session

from app.boxes.queries import LatestAnswers
from app.boxes.reader import describe_box
from app.db.base import utc_now
from app.db.engine import once_committed
from app.errors import StaleReview
from app.metrics import REVIEWS
from app.review.queries import Answer, ReviewRepository
from app.verdicts import effective_verdict
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
