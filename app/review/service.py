"""Answers of people: on one box or many, undone, or carried over to new frames.

All are stored in the same way (`app.review.queries`). An answer contains the revision
of the box that the person saw. If the box was answered since, a single answer is
refused (StaleReview), and a bulk answer on listed boxes skips it. A bulk answer on all
boxes of a filter is refused as a whole if one of them has changed (StaleSnapshot, in
`routes`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from sqlalchemy.orm import Session

from app.access.service import require_own
from app.boxes.queries import FrameRepository, LatestAnswers
from app.db.base import utc_now
from app.db.engine import once_committed
from app.db.tables import Dataset, Frame, ReviewBatch
from app.errors import Conflict, StaleReview, TooLarge, Unprocessable
from app.metrics import REVIEWS
from app.review.queries import (
    AnswerRow,
    ReviewBatches,
    ReviewRepository,
    SeenBoxes,
    Signature,
    StandingBoxes,
)
from app.security import Principal
from app.verdicts import effective_verdict
from filter_core.annotation.frame import GEOMETRIES
from unghost.wire.boxes import Review


@dataclass(frozen=True)
class Answer:
    """A person's answer on a box; `verdict` is what the person says of it."""

    verdict: str
    comment: str
    reviewer: str


def review_box(
    session: Session, box_id: int, answer: Answer, seen_revision: int
) -> Review:
    """Add one answer; StaleReview if the box was answered since it was seen."""
    reviews = ReviewRepository(session)
    box = reviews.state(box_id)
    seen = SeenBoxes([box_id], seen_revision)
    by = Signature(box.dataset_id, answer.reviewer, utc_now())
    if not reviews.answer([seen], answer.verdict, answer.comment, by):
        newest = LatestAnswers(session).of([box_id]).get(box_id)
        found = 0 if newest is None else newest.revision
        raise StaleReview(box_id=box_id, seen=seen_revision, found=found)
    once_committed(session, partial(_count, answer.verdict, 1))
    return Review(
        box_id=box_id,
        revision=seen_revision + 1,
        verdict=answer.verdict,
        reviewer=answer.reviewer,
        comment=answer.comment,
        created_at=by.at,
        effective_verdict=effective_verdict(box.reason, answer.verdict),
    )


@dataclass(frozen=True)
class ChosenBoxes:
    """Boxes for a bulk answer, selected before waiting for the turn to write.

    `boxes` are answered if they still have their revision then. `stale` were answered
    since they were seen, `skipped` no longer exist or are of another dataset.
    """

    boxes: list[SeenBoxes]
    stale: list[int]
    skipped: list[int]

    @property
    def number(self) -> int:
        """How many boxes the request selects."""
        return self.expected + len(self.stale) + len(self.skipped)

    @property
    def expected(self) -> int:
        """How many boxes are to be answered."""
        return sum(len(seen.box_ids) for seen in self.boxes)


@dataclass(frozen=True)
class StoredBatch:
    """A stored bulk answer, and the boxes that it left out.

    `stale` were answered since they were seen, `skipped` no longer exist or are of
    another dataset.
    """

    batch: ReviewBatch
    answered: int
    skipped: list[int]
    stale: list[int]


def review_many(
    session: Session, dataset: Dataset, chosen: ChosenBoxes, answer: Answer
) -> StoredBatch:
    """Add one answer to many boxes, except those that have changed since seen."""
    batches, reviews = ReviewBatches(session), ReviewRepository(session)
    batch = batches.add(
        ReviewBatch(
            dataset_id=dataset.id, verdict=answer.verdict, reviewer=answer.reviewer
        )
    )
    by = Signature(dataset.id, answer.reviewer, utc_now(), batch.id)
    answered = reviews.answer(chosen.boxes, answer.verdict, answer.comment, by)
    once_committed(session, partial(_count, answer.verdict, answered))
    if answered == chosen.expected:
        return StoredBatch(batch, answered, chosen.skipped, chosen.stale)
    taken = {box_id for seen in chosen.boxes for box_id in seen.box_ids}
    left = sorted(taken.difference(batches.boxes(batch.id)))
    stale = {state.box_id for state in reviews.states(dataset.id, left)}
    gone = [box_id for box_id in left if box_id not in stale]
    return StoredBatch(
        batch,
        answered,
        skipped=sorted([*chosen.skipped, *gone]),
        stale=sorted([*chosen.stale, *stale]),
    )


def listed_boxes(
    session: Session,
    dataset: Dataset,
    ids: Sequence[int],
    seen: Sequence[int] | None,
    limit: int,
) -> ChosenBoxes:
    """The boxes that a person listed, each once, and which have changed since seen.

    Parameters
    ----------
    ids : sequence of int
    seen : sequence of int, or None
        The revision of each box, in the order of `ids`. None if they are unknown: then
        only boxes without an answer are chosen.

    Raises
    ------
    Unprocessable
        There are more or fewer revisions than boxes, or two of one box.
    TooLarge
        There are more boxes than one bulk answer may change.
    """
    revision_of: dict[int, int | None] = dict.fromkeys(ids)
    if seen is not None:
        revision_of |= _seen_revisions(ids, seen)
    if len(revision_of) > limit:
        raise TooLarge(
            f"{len(revision_of)} boxes, one bulk answer changes at most {limit}"
        )
    alike: dict[int, list[int]] = {}
    stale: list[int] = []
    for state in ReviewRepository(session).states(dataset.id, sorted(revision_of)):
        expected = revision_of.pop(state.box_id)
        is_stale = (
            state.review is not None if expected is None else state.revision != expected
        )
        group = stale if is_stale else alike.setdefault(state.revision, [])
        group.append(state.box_id)
    boxes = [SeenBoxes(group, revision) for revision, group in alike.items()]
    return ChosenBoxes(boxes, sorted(stale), sorted(revision_of))


def _seen_revisions(ids: Sequence[int], seen: Sequence[int]) -> dict[int, int]:
    if len(seen) != len(ids):
        raise Unprocessable(
            f"seen_revisions: expected one for each of {len(ids)} box_ids, "
            f"found {len(seen)}"
        )
    revision_of: dict[int, int] = {}
    for box_id, revision in zip(ids, seen, strict=True):
        if revision_of.setdefault(box_id, revision) != revision:
            raise Unprocessable(
                f"seen_revisions: expected one revision of box {box_id}, found "
                f"{revision_of[box_id]} and {revision}"
            )
    return revision_of


def boxes_as_they_are(
    session: Session, dataset: Dataset, ids: Sequence[int]
) -> ChosenBoxes:
    """Boxes that a person has seen in the current state of this session."""
    alike: dict[int, list[int]] = {}
    for state in ReviewRepository(session).states(dataset.id, ids):
        alike.setdefault(state.revision, []).append(state.box_id)
    boxes = [SeenBoxes(group, revision) for revision, group in alike.items()]
    return ChosenBoxes(boxes, stale=[], skipped=[])


def standing_boxes(session: Session, batch_id: int) -> list[StandingBoxes]:
    """The answers that undoing a batch would undo; read before waiting to write."""
    return ReviewBatches(session).standing(batch_id)


def undo_batch(
    session: Session, batch_id: int, standing: Sequence[StandingBoxes], by: Principal
) -> tuple[ReviewBatch, int, list[int]]:
    """Undo a batch: repeat the answers before it, except where someone answered since.

    `standing` comes from `standing_boxes`. Boxes that were answered since then are left
    out.

    Raises
    ------
    NotFound
        There is no such batch.
    Forbidden
        It is another person's, and the caller is not an admin.
    Conflict
        It was undone already.
    """
    batches = ReviewBatches(session)
    batch = batches.with_id(batch_id)
    size = batches.size(batch_id)
    answers = {batch.reviewer: size}
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
    signed = Signature(batch.dataset_id, by.name, utc_now(), undo.id)
    undone = ReviewRepository(session).answer_as_before(standing, signed)
    once_committed(session, partial(_count, "undo", undone))
    if undone == size:
        return undo, undone, []
    skipped = set(batches.boxes(batch_id)).difference(batches.boxes(undo.id))
    return undo, undone, sorted(skipped)


class NewBox(NamedTuple):
    """A box of a new revision of a frame; `raw` is the box as it was sent."""

    id: int
    source_id: str
    class_id: int
    raw: Mapping[str, object]


def carry_reviews(
    session: Session, old: Frame, boxes: Iterable[NewBox]
) -> tuple[list[AnswerRow], Counter[str]]:
    """Repeat the latest answers on boxes whose class and geometry are the same.

    Returns
    -------
    carried : list of AnswerRow
        The repeated answers.
    set_aside : Counter of str
        How many answers are dropped, by reviewer: their boxes no longer exist, have
        changed, or have no answer in force. Answers that another person cleared or
        replaced, in any revision, count: otherwise people could remove others' answers
        by clearing them first. Answers that their author has undone do not count.
    """
    reviews = ReviewRepository(session)
    answered = reviews.answered_boxes(old.id)
    if not answered:
        return [], Counter()
    latest = LatestAnswers(session).of(former.id for former in answered)
    new = {box.source_id: box for box in boxes}
    annotation = FrameRepository(session).with_id(old.id, annotation=True).annotation
    carried: list[AnswerRow] = []
    left = []
    for former in answered:
        review, box = latest[former.id], new.get(former.source_id)
        raw = annotation["boxes"][former.id - old.first_box_id]
        if (
            box is None
            or review.verdict == "clear"
            or former.class_id != box.class_id
            or _geometry(raw) != _geometry(box.raw)
        ):
            left.append(former.id)
            continue
        carried.append(
            {
                "box_id": box.id,
                "revision": 1,
                "verdict": review.verdict,
                "comment": review.comment,
                "reviewer": review.reviewer,
                "batch_id": None,
                "carried_from": former.id,
                "created_at": utc_now(),
            }
        )
    if carried:
        reviews.carry_over(carried)
    return carried, reviews.meant_by(left)


def _count(verdict: str, answers: int) -> None:
    REVIEWS.labels(verdict).inc(answers)


def _geometry(raw: Mapping[str, object]) -> dict[str, object]:
    return {key: raw[key] for key in GEOMETRIES if key in raw}
