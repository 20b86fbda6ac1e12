"""Routes of answers, of the queue, and of a box's history."""

from __future__ import annotations

from fastapi import Request, Response

from app.access.gate import Audited
from app.catalog.datasets import DatasetRepository
from app.http.deps import (
    Admin,
    AnswerRevision,
    AppServices,
    DatasetName,
    ReadSession,
    Reviewer,
    RowId,
    Viewer,
    begin_answer,
)
from app.http.pages import NO_STORE, Cursor, Limit, json_response, page_response
from app.http.routing import ApiRouter
from app.http.transaction import WriteSession, commit_and_respond
from app.review.bulk import review_many, undo_batch
from app.review.coached import coached_boxes
from app.review.history import history
from app.review.queue import count_queue, next_boxes
from app.review.service import import_answers, review_box, undo_answer
from unghost.wire import boxes as wire

history_router = ApiRouter(prefix="/api/v1", tag="boxes")


@history_router.get("/boxes/{box_id}/history", response_model=wire.History)
def get_history(
    caller: Viewer,
    box_id: RowId,
    request: Request,
    session: ReadSession,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> Response:
    """Decisions of runs and answers of people on a box, newest first."""
    entries, following = history(session, box_id, limit=limit, cursor=cursor)
    return page_response(request, entries, following)


queue_router = ApiRouter(prefix="/api/v1", tag="queue")


@queue_router.post("/datasets/{dataset}/queue", response_model=wire.Queue)
def take_from_queue(
    caller: Reviewer,
    dataset: DatasetName,
    body: wire.QueueIn,
    session: WriteSession,
    services: AppServices,
) -> Response:
    """The next boxes to review, claimed for five minutes; an answer ends the claim."""
    parts = count_queue(services, dataset, caller.name, body)
    dataset_row = DatasetRepository(session).named(dataset)
    boxes = next_boxes(session, dataset_row, caller.name, body, parts)
    # With no-store the response is not stored under the Idempotency-Key of the request:
    # one that is sent again may get other boxes.
    return json_response(boxes, headers=NO_STORE)


@queue_router.get("/datasets/{dataset}/coached", response_model=wire.Coached)
def get_coached(caller: Viewer, dataset: DatasetName, session: ReadSession) -> Response:
    """The boxes by which the caller learns to answer; their truth is known."""
    dataset_row = DatasetRepository(session).named(dataset)
    return json_response({"items": coached_boxes(session, dataset_row, caller.name)})


router = ApiRouter(prefix="/api/v1", tag="reviews")


@router.post(
    "/boxes/{box_id}/reviews",
    status_code=201,
    response_model=wire.Review,
    responses={200: {"model": wire.Review, "description": "Stored already."}},
)
def create_review(
    caller: Reviewer,
    box_id: RowId,
    body: wire.ReviewIn,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Answer a box; 412 with the current decision if it was answered since seen.

    200 if this is the caller's own latest answer on the box: it is not stored again.
    Only admins may clear answers of others.
    """
    begin_answer(services, audit.session)
    most = services.settings.max_answers_per_box
    review = review_box(audit, box_id, body, caller, most=most)
    status = 200 if review.revision == body.seen_revision else 201
    return commit_and_respond(audit.session, json_response(review, status))


@router.post(
    "/boxes/{box_id}/reviews/{revision}/undo",
    status_code=201,
    response_model=wire.Review,
)
def undo_review(
    caller: Reviewer,
    box_id: RowId,
    revision: AnswerRevision,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Undo an answer on a box: the box gets the answer it had before.

    409 if somebody has answered since. Only admins may undo answers of others.
    """
    begin_answer(services, audit.session)
    most = services.settings.max_answers_per_box
    review = undo_answer(audit, box_id, revision, caller, most=most)
    return commit_and_respond(audit.session, json_response(review, 201))


@router.post("/reviews/bulk", status_code=201, response_model=wire.ReviewBatch)
def create_bulk_review(
    caller: Reviewer, body: wire.BulkIn, services: AppServices, audit: Audited
) -> Response:
    """Give many boxes one answer; a single undo takes it back on all of them.

    If each of the boxes has it already as the caller's own latest answer, it is not
    stored again, and `count` is 0. Only admins may clear answers of others.
    """
    batch = review_many(services, audit, body, caller)
    response = json_response(batch, 201)
    response.headers["Location"] = f"/api/v1/review-batches/{batch.id}"
    return commit_and_respond(audit.session, response)


@router.post("/review-batches/{batch_id}/undo", response_model=wire.UndoneBatch)
def undo_bulk_review(
    caller: Reviewer, batch_id: RowId, services: AppServices, audit: Audited
) -> Response:
    """Undo a bulk answer: boxes get the answers they had, unless answered since.

    Only admins may undo batches of others.
    """
    undone = undo_batch(services, audit, batch_id, caller)
    return commit_and_respond(audit.session, json_response(undone))


@router.post("/datasets/{dataset}/reviews/import", response_model=wire.ImportedAnswers)
def import_reviews(
    caller: Admin,
    dataset: DatasetName,
    body: wire.AnswersIn,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Store answers given elsewhere, with reviewer and time, unless newer ones exist.

    They are marked as imported by the caller.
    """
    begin_answer(services, audit.session)
    dataset_row = DatasetRepository(audit.session).named(dataset)
    outcome = import_answers(audit, dataset_row, body)
    return commit_and_respond(audit.session, json_response(outcome))
