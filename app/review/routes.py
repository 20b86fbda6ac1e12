"""Routes of answers, of the queue, and of a box's history."""

from __future__ import annotations

from fastapi import Response
from sqlalchemy.orm import Session

from app.access.audit import Act
from app.access.gate import Audited
from app.boxes.filter import selection_of
from app.boxes.reader import describe_box
from app.boxes.snapshot import select_boxes
from app.context import ServiceContext
from app.db.engine import begin_as_work
from app.db.tables import Dataset
from app.errors import (
    AppError,
    CountChanged,
    StaleReview,
    StaleSnapshot,
    Unprocessable,
)
from app.http.deps import (
    AppServices,
    CurrentPrincipal,
    DatasetName,
    ReadSession,
    RowId,
)
from app.http.pages import json_response
from app.http.routing import ApiRouter
from app.http.transaction import WriteSession, commit_and_respond
from app.measuring.queries import DatasetRepository
from app.review import service as reviews
from app.review.history import history
from app.review.queue import QueueRequest, next_boxes, remaining_boxes
from unghost.wire.boxes import (
    BulkIn,
    History,
    Queue,
    QueueIn,
    Review,
    ReviewBatch,
    ReviewIn,
    UndoneBatch,
)

history_router = ApiRouter(prefix="/api/v1", tag="boxes")


@history_router.get(
    "/boxes/{box_id}/history",
    response_model=History,
)
def get_history(box_id: RowId, session: ReadSession) -> History:
    """Decisions of runs and answers of people on a box, newest first."""
    return History(items=tuple(history(session, box_id)))


queue_router = ApiRouter(prefix="/api/v1", tag="queue")


@queue_router.post("/datasets/{dataset}/queue", response_model=Queue)
def take_from_queue(
    dataset: DatasetName,
    body: QueueIn,
    session: WriteSession,
    services: AppServices,
    principal: CurrentPrincipal,
) -> Response:
    """The next boxes to review, claimed for five minutes; an answer ends the claim."""
    chosen = body.model_dump(exclude={"filters"})
    filters = selection_of(body.filters)
    wanted = QueueRequest(principal.name, selection=filters, **chosen)
    queue = remaining_boxes(services, dataset, wanted)
    found = DatasetRepository(session).named(dataset)
    return json_response(next_boxes(session, found, wanted, queue))


router = ApiRouter(prefix="/api/v1", tag="reviews")


@router.post("/boxes/{box_id}/reviews", status_code=201, response_model=Review)
def create_review(
    box_id: RowId,
    body: ReviewIn,
    session: WriteSession,
    principal: CurrentPrincipal,
) -> Response:
    """Answer a box; 412 with the current decision if it was answered since seen."""
    answer = reviews.Answer(body.verdict, body.comment, principal.name)
    try:
        stored = reviews.review_box(session, box_id, answer, body.seen_revision)
    except StaleReview as stale:
        stale.current = describe_box(session, box_id)
        raise
    content = stored.model_dump_json()
    return commit_and_respond(
        session, Response(content, 201, media_type="application/json")
    )


@router.post("/reviews/bulk", status_code=201, response_model=ReviewBatch)
def create_bulk_review(
    body: BulkIn,
    services: AppServices,
    audit: Audited,
) -> Response:
    """One answer on many boxes, which one undo takes back."""
    try:
        run_id, chosen = _find_boxes(body, services)
    except AppError:
        # A repeated request gets its first response when the transaction begins.
        begin_as_work(audit.session)
        raise
    begin_as_work(audit.session)
    dataset = DatasetRepository(audit.session).named(body.dataset)
    answer = reviews.Answer(body.verdict, body.comment, audit.name)
    attempt = audit.session.begin_nested()
    stored = reviews.review_many(audit.session, dataset, chosen, answer)
    left = len(stored.skipped) + len(stored.stale)
    if body.filter is not None and (left or dataset.active_run_id != run_id):
        attempt.rollback()  # so that these answers are not among the changes
        _boxes(body, services, audit.session, dataset)  # raises what has changed
        raise StaleSnapshot(
            expected=chosen.number,
            found=chosen.number,
            changed=left,
            current={"total": chosen.number, "snapshot": body.snapshot},
        )
    attempt.commit()
    audit.note(
        Act.ANSWERS_GIVEN,
        stored.batch.id,
        dataset=dataset.name,
        verdict=body.verdict,
        answers=stored.answered,
        skipped=left,
    )
    content = ReviewBatch(
        id=stored.batch.id,
        dataset=dataset.name,
        verdict=stored.batch.verdict,
        count=stored.answered,
        skipped=tuple(stored.skipped),
        stale=tuple(stored.stale),
    ).model_dump_json()
    headers = {"Location": f"/api/v1/review-batches/{stored.batch.id}"}
    return commit_and_respond(
        audit.session, Response(content, 201, headers, media_type="application/json")
    )


def _find_boxes(
    body: BulkIn, services: ServiceContext
) -> tuple[int | None, reviews.ChosenBoxes]:
    """The run that decided the dataset, and the boxes that a body selects.

    They are read before waiting for the turn to write. The revision of a box shows if
    it is answered in between.
    """
    with services.database.read() as session:
        dataset = DatasetRepository(session).named(body.dataset)
        chosen = _boxes(body, services, session, dataset)
        found, expected = chosen.number, body.expected_count
        if expected is not None and expected != found:
            what = "box_ids lists" if body.filter is None else "the filter selects"
            raise CountChanged(what, found=found, expected=expected)
        return dataset.active_run_id, chosen


def _boxes(
    body: BulkIn, services: ServiceContext, session: Session, dataset: Dataset
) -> reviews.ChosenBoxes:
    """The boxes that a body selects, each with the revision that was seen.

    Raises
    ------
    Unprocessable
        The body has neither `box_ids` nor `filter`, or both, or a wrong field for it.
    StaleSnapshot
        The boxes of the filter have changed since the snapshot.
    """
    if (body.box_ids is None) == (body.filter is None):
        raise Unprocessable("expected either box_ids or filter, found both or neither")
    if body.filter is not None:
        if body.snapshot is None or body.seen_revisions is not None:
            raise Unprocessable(
                "expected a filter with snapshot, which a list of its boxes contains "
                "together with total for count=true, found it without snapshot or with "
                "seen_revisions",
            )
        wanted = selection_of(body.filter)
        ids = select_boxes(services, session, dataset, wanted, body.snapshot)
        return reviews.boxes_as_they_are(session, dataset, ids)
    if body.snapshot is not None:
        raise Unprocessable(
            "expected box_ids with seen_revisions, found them with snapshot, which "
            "belongs to a filter"
        )
    limit = services.settings.max_bulk_boxes
    return reviews.listed_boxes(
        session, dataset, body.box_ids or [], body.seen_revisions, limit
    )


@router.post("/review-batches/{batch_id}/undo", response_model=UndoneBatch)
def undo_bulk_review(
    batch_id: RowId,
    services: AppServices,
    principal: CurrentPrincipal,
    audit: Audited,
) -> Response:
    """Undo a bulk answer: boxes get the answers they had, unless answered since.

    Only admins may undo batches of others.
    """
    with services.database.read() as looking:
        standing = reviews.standing_boxes(looking, batch_id)
    begin_as_work(audit.session)
    undo, undone, skipped = reviews.undo_batch(
        audit.session, batch_id, standing, principal
    )
    dataset = DatasetRepository(audit.session).with_id(undo.dataset_id)
    audit.note(
        Act.ANSWERS_UNDONE,
        batch_id,
        dataset=dataset.name,
        batch=undo.id,
        answers=undone,
        skipped=len(skipped),
    )
    done = UndoneBatch(id=undo.id, undone=undone, skipped=tuple(skipped))
    content = done.model_dump_json()
    return commit_and_respond(
        audit.session, Response(content, media_type="application/json")
    )
