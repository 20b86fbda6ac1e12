"""Stores a person's answer on one box.

1. `create_review` (`routes`) begins the transaction, by `begin_answer`
   (`app.http.deps`). The transaction waits until no other one writes, and stores the
   idempotency key of the request (`app.http.transaction`). Then, if the disk is almost
   full, the answer is refused with 503: the page keeps it and sends it again.
2. `review_box` reads the current state of the box (`ReviewRepository.state`).
3. `ReviewRepository.answer_box` inserts the answer as a row of `reviews`, if the box
   still has the revision that the person saw; if not, `review_box` raises StaleReview,
   and the client gets the status 412.
4. `answer_box` then ends the claim on the box (the queue reserves a box for one person)
   and calls `copy_answers` (`app.boxes.current`), which copies the answer to the
   decision of the box and corrects the stored counts of boxes by answer.
5. `commit_and_respond` (`app.http.transaction`) commits, and only then is the stored
   answer sent back.

`import_answers` stores answers that were given somewhere else, as they are in a file.

`undo_answer` undoes an answer in the same way: the answer before it is stored once
more. Answers on many boxes at once, and their undo, are in `bulk`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from itertools import chain

from app.access.audit import AuditAction, AuditTrail
from app.access.service import require_own
from app.boxes.queries import LatestAnswers
from app.boxes.reader import describe_box
from app.catalog.datasets import DatasetRepository
from app.db.base import existing, utc_now
from app.db.engine import once_committed
from app.db.tables import Dataset
from app.errors import Conflict, StaleReview
from app.metrics import REVIEWS
from app.review.queries import (
    CurrentBox,
    NewAnswer,
    ReviewRepository,
    SeenBoxes,
)
from app.security import Principal
from app.verdicts import effective_verdict
from unghost.wire import boxes as wire


def review_box(
    audit: AuditTrail, box_id: int, request: wire.ReviewIn, by: Principal, *, most: int
) -> wire.Review:
    """Store an answer on a box; `most` is how many a person may give on one box.

    An answer that repeats the person's own latest one is not stored again: that one is
    returned, with the seen revision. If answers of others are cleared, this is noted in
    the audit log. Raises NotFound: the box does not exist, or its frame was replaced or
    deleted; StaleReview: the box was answered since the person saw it; contains its
    current decision; Forbidden: it clears answers of others, and the caller is not an
    admin; Conflict: ``too_many_answers``, see `require_answers_left`.
    """
    session, of_others = audit.session, 0
    reviews = ReviewRepository(session)
    box = reviews.state(box_id)
    answer = NewAnswer(
        *(box.dataset_id, request.verdict, request.comment, by.name, utc_now()),
        looked_ms=request.looked_ms,
    )
    if box.revision == request.seen_revision:
        same = reviews.same_answer(box, answer)
        if same is not None:
            reviews.end_claim(box_id)
            answer = answer._replace(created_at=same.created_at)
            return _stored(box, answer, box.revision)
        seen = [SeenBoxes([box_id], box.revision)]
        require_answers_left(reviews, seen, by.name, most)
        if answer.verdict == "clear":
            of_others = require_own_cleared(reviews, seen, by, f"clearing box {box_id}")
    if not reviews.answer_box(box_id, request.seen_revision, answer):
        newest = LatestAnswers(session).of([box_id]).get(box_id)
        raise StaleReview(
            box_id=box_id,
            seen=request.seen_revision,
            found=0 if newest is None else newest.revision,
            current=describe_box(session, box_id),
        )
    if of_others:
        audit.note(
            AuditAction.ANSWER_CLEARED,
            box_id,
            dataset=DatasetRepository(session).with_id(box.dataset_id).name,
            revision=request.seen_revision + 1,
            of_others=of_others,
        )
    once_committed(session, lambda: REVIEWS.labels(answer.verdict).inc())
    return _stored(box, answer, request.seen_revision + 1)


def undo_answer(
    audit: AuditTrail, box_id: int, revision: int, by: Principal, *, most: int
) -> wire.Review:
    """Undo the answer that gave a box this revision: repeat the answer before it.

    If it is another person's, this is noted in the audit log. An undo counts as an
    answer; `most` is how many a person may give on one box. Raises NotFound: the box
    does not exist, or its frame was replaced, or it has no such answer; Forbidden: it
    is another person's answer, and the caller is not an admin; Conflict: the box was
    answered since, or the answer was undone already; or ``too_many_answers``, see
    `require_answers_left`.
    """
    session = audit.session
    reviews = ReviewRepository(session)
    box = reviews.state(box_id)
    undone = existing(
        reviews.at(box_id, revision), f"answer on box {box_id} with revision", revision
    )
    what = f"answer {revision} on box {box_id}"
    of_others = require_own(by, {undone.reviewer: 1}, f"undoing {what}")
    require_answers_left(reviews, [SeenBoxes([box_id], box.revision)], by.name, most)
    before = reviews.at(box_id, revision - 1)
    # "clear" is stored where a box had no answer before.
    content = ("clear", "") if before is None else (before.verdict, before.comment)
    answer = NewAnswer(box.dataset_id, *content, by.name, utc_now(), undoes=revision)
    is_in_force = reviews.is_in_force(undone)
    if not (is_in_force and reviews.answer_box(box_id, box.revision, answer)):
        raise Conflict(
            f"{what} is not in force any more: others followed, or it was undone",
            code="not_in_force",
        )
    if of_others:
        audit.note(
            AuditAction.ANSWER_UNDONE,
            box_id,
            dataset=DatasetRepository(session).with_id(box.dataset_id).name,
            revision=revision,
            reviewer=undone.reviewer,
        )
    once_committed(session, lambda: REVIEWS.labels("undo").inc())
    return _stored(box, answer, box.revision + 1)


def import_answers(
    audit: AuditTrail, dataset: Dataset, body: wire.AnswersIn
) -> wire.ImportedAnswers:
    """Store answers that were given somewhere else, with their reviewers and times.

    They are marked as imported, in the order of their times. An answer on a box that
    has a newer one is not stored, and neither is one that the box has already. A time
    in the future becomes the present one.
    """
    session, reviews = audit.session, ReviewRepository(audit.session)
    answers = sorted(body.answers, key=lambda answer: answer.created_at)
    boxes = reviews.boxes_of(
        dataset.id,
        {answer.frame for answer in answers},
        {answer.box for answer in answers},
    )
    outcomes: Counter[str] = Counter()
    unknown = []
    now = utc_now()
    for answer in answers:
        box_id = boxes.get((answer.frame, answer.box))
        if box_id is None:
            outcomes["unknown"] += 1
            unknown.append(f"{answer.frame} {answer.box}")
            continue
        at = min(answer.created_at, now)
        review = NewAnswer(
            *(dataset.id, answer.verdict, answer.comment, answer.reviewer, at),
            imported_by=audit.name,
        )
        latest = LatestAnswers(session).of([box_id]).get(box_id)
        if latest is None or latest.created_at < at:
            revision = 0 if latest is None else latest.revision
            stored = reviews.answer_box(box_id, revision, review)
            assert stored, "no other transaction writes"
            outcomes["imported"] += 1
        else:
            there = (latest.verdict, latest.comment, latest.reviewer, latest.created_at)
            outcomes["already" if review[1:5] == there else "newer"] += 1
    if outcomes["imported"]:
        audit.note(
            AuditAction.ANSWERS_IMPORTED,
            dataset.name,
            answers=outcomes["imported"],
            skipped=outcomes.total() - outcomes["imported"],
            reviewers=sorted({answer.reviewer for answer in answers})[
                : wire.MOST_UNKNOWN
            ],
        )
    return wire.ImportedAnswers(
        imported=outcomes["imported"],
        already=outcomes["already"],
        newer=outcomes["newer"],
        unknown=outcomes["unknown"],
        unknown_boxes=tuple(unknown[: wire.MOST_UNKNOWN]),
    )


def require_own_cleared(
    reviews: ReviewRepository, boxes: Iterable[SeenBoxes], by: Principal, action: str
) -> int:
    """Allow `clear` on boxes without answers of others, and to admins.

    Answers count that others have overruled, as for replaced frames
    (`ReviewRepository.answers_in_force`). Returns how many of them are other people's.
    Raises Forbidden: some are other people's, and the caller is not an admin.
    """
    answered = chain.from_iterable(seen.box_ids for seen in boxes if seen.revision)
    answers = Counter(who for _, who in reviews.answers_in_force(answered))
    return require_own(by, answers, action)


def require_answers_left(
    reviews: ReviewRepository,
    boxes: Iterable[SeenBoxes],
    reviewer: str,
    most: int,
) -> None:
    """Refuse one more answer of a person who has `most` answers on one of these boxes.

    Of one person, so that nobody can keep others from answering a box. Raises Conflict:
    ``too_many_answers``.
    """
    for seen in boxes:
        # A box with a lower revision has fewer answers of all people together.
        is_near = seen.revision >= most
        full = reviews.full_box(seen.box_ids, reviewer, most) if is_near else None
        if full is not None:
            raise Conflict(
                f"box {full} has {most} answers of {reviewer!r} already, undone ones "
                "included, and one person may give no more; somebody else can answer "
                "it, or raise UNGHOST_MAX_ANSWERS_PER_BOX and restart the service",
                code="too_many_answers",
            )


def _stored(box: CurrentBox, answer: NewAnswer, revision: int) -> wire.Review:
    return wire.Review(
        box_id=box.box_id,
        revision=revision,
        verdict=answer.verdict,
        reviewer=answer.reviewer,
        comment=answer.comment,
        created_at=answer.created_at,
        effective_verdict=effective_verdict(box.reason, answer.verdict),
    )
