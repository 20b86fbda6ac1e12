"""Answers of people: on one box, on many, and taken back."""

from __future__ import annotations

from typing import Any

from fastapi import Response

from app.deps import AppServices, CurrentPrincipal, RowId, WriteSession
from app.errors import StaleReview, Unprocessable
from app.repositories.datasets import DatasetRepository
from app.routes.selections import selection_of
from app.routing import ApiRouter
from app.schemas.reviews import BulkIn, BulkOut, ReviewIn, ReviewOut, UndoOut
from app.services import reviews
from app.services.box_selection import to_filter
from app.services.boxes import describe_box
from app.services.bulk_selection import select_boxes

router = ApiRouter(prefix="/api/v1", tag="reviews")


@router.post("/boxes/{box_id}/reviews", status_code=201, response_model=ReviewOut)
def create_review(
    box_id: RowId, body: ReviewIn, session: WriteSession, principal: CurrentPrincipal
) -> dict[str, Any]:
    """Answer on a box; 412 with the current decision if someone was faster."""
    answer = reviews.Answer(body.verdict, body.comment, principal.name)
    try:
        stored = reviews.review_box(session, box_id, answer, body.seen_revision)
    except StaleReview as stale:
        stale.current = describe_box(session, box_id)
        raise
    return {**stored.row, "effective_verdict": stored.effective_verdict}


@router.post("/reviews/bulk", status_code=201, response_model=BulkOut)
def create_bulk_review(
    body: BulkIn,
    response: Response,
    session: WriteSession,
    services: AppServices,
    principal: CurrentPrincipal,
) -> dict[str, Any]:
    """One answer on many boxes: one act, one undo."""
    dataset = DatasetRepository(session).named(body.dataset)
    if (body.box_ids is None) == (body.filter is None):
        raise Unprocessable("expected either box_ids or filter, found both or neither")
    if body.filter is not None:
        if body.expected_count is None:
            raise Unprocessable("a filter needs expected_count, the number you saw")
        wanted = to_filter(session, dataset, selection_of(body.filter))
        ids = select_boxes(services, session, dataset, wanted, body.expected_count)
    else:
        limit = services.settings.max_bulk_boxes
        ids = reviews.listed_boxes(body.box_ids or [], body.expected_count, limit)
    answer = reviews.Answer(body.verdict, body.comment, principal.name)
    batch, answered, skipped = reviews.review_many(session, dataset, ids, answer)
    response.headers["Location"] = f"/api/v1/review-batches/{batch.id}"
    return {
        "id": batch.id,
        "dataset": dataset.name,
        "verdict": batch.verdict,
        "count": answered,
        "skipped": skipped,
    }


@router.post("/review-batches/{batch_id}/undo", response_model=UndoOut)
def undo_bulk_review(
    batch_id: RowId, session: WriteSession, principal: CurrentPrincipal
) -> dict[str, Any]:
    """Say again what was said before the batch, but where someone spoke since."""
    undo, undone, skipped = reviews.undo_batch(session, batch_id, principal.name)
    return {"id": undo.id, "undone": undone, "skipped": skipped}
