"""Bulk answers: one answer on many boxes, and its undo.

Both look up the boxes in a session that only reads, before they wait for their turn to
write; others write meanwhile. When it is their turn, boxes that were answered in the
meantime have another revision and are left out. For a bulk answer on a list of boxes
they are reported (`stale`). One on all boxes of a filter is refused as a whole
(StaleSnapshot), because the client does not know which boxes the filter selected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from sqlalchemy.orm import Session

from app.access.audit import AuditAction, AuditTrail
from app.access.service import require_own
from app.boxes.snapshot import select_boxes
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db.engine import begin_as_work, once_committed
from app.db.tables import Dataset
from app.errors import Conflict, CountChanged, StaleSnapshot, TooLarge, Unprocessable
from app.metrics import REVIEWS
from app.review.queries import ReviewBatches, ReviewRepository, SeenBoxes
from app.review.service import require_answers_left, require_own_cleared
from app.security import Principal
from app.storage.room import require_room
from unghost.wire.boxes import MAX_COMMENT, BulkIn, ReviewBatch, UndoneBatch


def review_many(
    services: ServiceContext, audit: AuditTrail, request: BulkIn, by: Principal
) -> ReviewBatch:
    """Store one answer on many boxes; the transaction of `audit` must not have begun.

    If it is the caller's latest answer on each of the boxes already, no box gets
    another one, and the bulk answer has none. Raises NotFound: there is no such
    dataset; Unprocessable: `request` has neither `box_ids` nor `filter`, or both, or a
    wrong field for it; TooLarge: there are more boxes than one bulk answer may change;
    CountChanged: there are more or fewer boxes than `request.expected_count`;
    StaleSnapshot: the boxes of the filter have changed since the snapshot; StorageFull:
    there is too little disk space for so many answers; Forbidden: it clears answers of
    others, and the caller is not an admin; Conflict: ``too_many_answers`` on one of the
    boxes, see `require_answers_left`.
    """
    try:
        chosen = _choose(services, request, by)
    finally:
        # Also after an error: a repeated request finds its boxes changed by the first
        # one, and beginning the transaction then raises `RepeatedRequest` instead.
        begin_as_work(audit.session)
    _require_room(services, chosen.to_answer, len(request.comment.encode()))
    most = services.settings.max_answers_per_box
    require_answers_left(
        ReviewRepository(audit.session), chosen.boxes, audit.name, most
    )
    dataset = DatasetRepository(audit.session).named(request.dataset)
    attempt = audit.session.begin_nested()
    stored = _store(audit, dataset, request, chosen)
    left = len(stored.skipped) + len(stored.stale)
    if request.filter is not None and (left or dataset.active_run_id != chosen.run_id):
        # Without the answers that were just stored, the filter is selected once more:
        # this raises StaleSnapshot with the numbers of what others have changed.
        attempt.rollback()
        _boxes_of_filter(services, audit.session, dataset, request)
        raise StaleSnapshot(
            expected=chosen.number,
            found=chosen.number,
            changed=left,
            current={"total": chosen.number, "snapshot": request.snapshot},
        )
    attempt.commit()
    if chosen.repeated:
        return stored
    audit.note(
        AuditAction.ANSWERS_GIVEN,
        stored.id,
        dataset=dataset.name,
        verdict=request.verdict,
        answers=stored.count,
        skipped=left,
        **({} if request.looked_at is None else {"looked_at": request.looked_at}),
        **({"of_others": chosen.of_others} if request.verdict == "clear" else {}),
    )
    return stored


_ANSWER_BYTES: Final = 500
"""Disk space of one answer, apart from its comment: a row, its entries in indexes, and
both once more in the database's log."""


def _require_room(services: ServiceContext, answers: int, comment_bytes: int) -> None:
    """Refuse so many answers with a comment of this size if the disk is too full."""
    needed = answers * (_ANSWER_BYTES + 2 * comment_bytes)
    require_room(services.settings, services.storage, needed)


@dataclass(frozen=True)
class _ChosenBoxes:
    """Boxes for a bulk answer, and the run that decided them when they were looked up.

    `boxes` are answered if they still have their revision when it is the turn to write.
    `stale` were answered since they were seen, `skipped` do not exist or are of another
    dataset. `of_others` are the answers of others that the bulk answer clears.
    `repeated` is the number of boxes if all have the answer already: then `boxes` is
    empty.
    """

    run_id: int | None
    boxes: list[SeenBoxes]
    stale: list[int]
    skipped: list[int]
    of_others: int = 0
    repeated: int = 0

    @property
    def to_answer(self) -> int:
        """How many boxes are to be answered."""
        return sum(len(seen.box_ids) for seen in self.boxes)

    @property
    def number(self) -> int:
        """How many boxes the request selects."""
        left = len(self.stale) + len(self.skipped)
        return self.to_answer + self.repeated + left


def _choose(services: ServiceContext, request: BulkIn, by: Principal) -> _ChosenBoxes:
    """The boxes that a request selects, as far as they are as the person saw them."""
    with services.database.read() as session:
        dataset = DatasetRepository(session).named(request.dataset)
        if (request.box_ids is None) == (request.filter is None):
            raise Unprocessable(
                "expected either box_ids or filter, found both or neither"
            )
        if request.box_ids is None:
            what = "the filter selects"
            chosen = _boxes_of_filter(services, session, dataset, request)
        else:
            what = "box_ids lists"
            limit = services.settings.max_bulk_boxes
            chosen = _listed_boxes(session, dataset, request, limit)
        expected = request.expected_count
        if expected is not None and expected != chosen.number:
            raise CountChanged(what, found=chosen.number, expected=expected)
        reviews, action = ReviewRepository(session), f"clearing {chosen.number} boxes"
        if reviews.repeats(chosen.boxes, request.verdict, request.comment, by.name):
            return replace(chosen, boxes=[], repeated=chosen.to_answer)
        if request.verdict != "clear":
            return chosen
        # Boxes that others answer from here on have another revision, and are left out.
        of_others = require_own_cleared(reviews, chosen.boxes, by, action)
    return replace(chosen, of_others=of_others)


def _boxes_of_filter(
    services: ServiceContext, session: Session, dataset: Dataset, request: BulkIn
) -> _ChosenBoxes:
    """All boxes of the filter; StaleSnapshot if they are not as in the snapshot."""
    assert request.filter is not None
    if request.snapshot is None or request.seen_revisions is not None:
        raise Unprocessable(
            "expected a filter with snapshot, which a list of its boxes contains "
            "together with total for count=true, found it without snapshot or with "
            "seen_revisions"
        )
    ids = select_boxes(services, session, dataset, request.filter, request.snapshot)
    alike: dict[int, list[int]] = {}
    for state in ReviewRepository(session).states(dataset.id, ids):
        alike.setdefault(state.revision, []).append(state.box_id)
    return _ChosenBoxes(dataset.active_run_id, _seen(alike), stale=[], skipped=[])


def _listed_boxes(
    session: Session, dataset: Dataset, request: BulkIn, limit: int
) -> _ChosenBoxes:
    """The boxes of `box_ids`, each once, and which have changed since they were seen.

    Without `seen_revisions`, only boxes without an answer are to be answered.
    """
    assert request.box_ids is not None
    if request.snapshot is not None:
        raise Unprocessable(
            "expected box_ids with seen_revisions, found them with snapshot, which "
            "belongs to a filter"
        )
    ids, seen = request.box_ids, request.seen_revisions
    if seen is None:
        revision_of: dict[int, int | None] = dict.fromkeys(ids)
    else:
        revision_of = {**_seen_revisions(ids, seen)}
    if len(revision_of) > limit:
        raise TooLarge(
            f"{len(revision_of)} boxes, one bulk answer changes at most {limit}"
        )
    alike: dict[int, list[int]] = {}
    stale: list[int] = []
    for state in ReviewRepository(session).states(dataset.id, sorted(revision_of)):
        expected = revision_of.pop(state.box_id)
        is_unanswered = expected is None and state.review is None
        if is_unanswered or state.revision == expected:
            alike.setdefault(state.revision, []).append(state.box_id)
        else:
            stale.append(state.box_id)
    run_id = dataset.active_run_id
    return _ChosenBoxes(run_id, _seen(alike), sorted(stale), sorted(revision_of))


def _seen_revisions(ids: Sequence[int], seen: Sequence[int]) -> dict[int, int]:
    """The revision of each box; Unprocessable if one has none, or two."""
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


def _seen(alike: dict[int, list[int]]) -> list[SeenBoxes]:
    """Boxes by revision, as `ReviewRepository.answer_boxes` takes them."""
    return [SeenBoxes(ids, revision) for revision, ids in alike.items()]


def _store(
    audit: AuditTrail, dataset: Dataset, request: BulkIn, chosen: _ChosenBoxes
) -> ReviewBatch:
    """Store the answer on those of the chosen boxes that have not changed meanwhile."""
    session, verdict = audit.session, request.verdict
    batches, reviews = ReviewBatches(session), ReviewRepository(session)
    batch = batches.add(dataset.id, verdict, audit.name, looked_at=request.looked_at)
    answered = reviews.answer_boxes(batch, request.comment, chosen.boxes)
    once_committed(session, lambda: REVIEWS.labels(verdict).inc(answered))
    gone: set[int] = set()
    stale: set[int] = set()
    if answered != chosen.to_answer:
        gone = {box_id for seen in chosen.boxes for box_id in seen.box_ids}
        gone.difference_update(batches.boxes(batch.id))
        stale = {state.box_id for state in reviews.states(dataset.id, sorted(gone))}
        gone -= stale
    return ReviewBatch(
        id=batch.id,
        dataset=dataset.name,
        verdict=verdict,
        count=answered,
        skipped=tuple(sorted([*chosen.skipped, *gone])),
        stale=tuple(sorted([*chosen.stale, *stale])),
    )


def undo_batch(
    services: ServiceContext, audit: AuditTrail, batch_id: int, by: Principal
) -> UndoneBatch:
    """Undo a bulk answer: repeat the answers before it, unless others followed.

    The transaction of `audit` must not have begun. Raises NotFound: there is no such
    batch; Forbidden: it is another person's, and the caller is not an admin; Conflict:
    it was undone already, and none of its answers is in force again; or
    ``too_many_answers`` on one of the boxes, see `require_answers_left`; StorageFull:
    there is too little disk space for so many answers.
    """
    with services.database.read() as looking:
        undoable = ReviewBatches(looking).undoable(batch_id)
    session = audit.session
    begin_as_work(session)
    batches = ReviewBatches(session)
    batch = batches.with_id(batch_id)
    size = batches.size(batch_id)
    require_own(by, {batch.reviewer: size}, f"undoing bulk answer {batch_id}")
    # The answers before it are repeated, with comments of up to four bytes a character.
    _require_room(services, size, 4 * MAX_COMMENT)
    most = services.settings.max_answers_per_box
    seen = [boxes for _, boxes in undoable]
    require_answers_left(ReviewRepository(session), seen, by.name, most)
    was_undone = batches.is_undone(batch_id)
    undo = batches.add(batch.dataset_id, "clear", by.name, undoes_id=batch_id)
    undone = ReviewRepository(session).restore_answers(undo, undoable)
    if was_undone and undone == 0:
        raise Conflict(
            f"bulk answer {batch_id} was undone already", code="already_undone"
        )
    once_committed(session, lambda: REVIEWS.labels("undo").inc(undone))
    skipped: set[int] = set()
    if undone != size:
        skipped = set(batches.boxes(batch_id)).difference(batches.boxes(undo.id))
    audit.note(
        AuditAction.ANSWERS_UNDONE,
        batch_id,
        dataset=DatasetRepository(session).with_id(batch.dataset_id).name,
        batch=undo.id,
        answers=undone,
        skipped=len(skipped),
    )
    return UndoneBatch(id=undo.id, undone=undone, skipped=tuple(sorted(skipped)))
