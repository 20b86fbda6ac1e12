"""Answers of people: on one box, on many, and taken back."""

from __future__ import annotations

from typing import Any

from fastapi import Request, Response
from sqlalchemy.orm import Session

from app.db.tables import Dataset
from app.deps import AppServices, Audited, CurrentPrincipal, RowId, WriteSession
from app.errors import CountChanged, StaleReview, Unprocessable
from app.repositories.datasets import DatasetRepository
from app.repositories.review_batches import SeenBoxes
from app.routes.selections import selection_of
from app.routing import ApiRouter, committed
from app.schemas.reviews import BulkIn, BulkOut, ReviewIn, ReviewOut, UndoOut
from app.services import reviews
from app.services.audit import Act
from app.services.boxes import describe_box
from app.services.bulk_selection import select_boxes
from app.services.context import ServiceContext

router = ApiRouter(prefix="/api/v1", tag="reviews")


@router.post("/boxes/{box_id}/reviews", status_code=201, response_model=ReviewOut)
def create_review(
    box_id: RowId,
    body: ReviewIn,
    request: Request,
    session: WriteSession,
    principal: CurrentPrincipal,
) -> Response:
    """Answer on a box; 412 with the current decision if someone was faster."""
    answer = reviews.Answer(body.verdict, body.comment, principal.name)
    try:
        stored = reviews.review_box(session, box_id, answer, body.seen_revision)
    except StaleReview as stale:
        stale.current = describe_box(session, box_id)
        raise
    found = {**stored.row, "effective_verdict": stored.effective_verdict}
    content = ReviewOut.model_validate(found).model_dump_json()
    return committed(request, Response(content, 201, media_type="application/json"))


@router.post("/reviews/bulk", status_code=201, response_model=BulkOut)
def create_bulk_review(
    body: BulkIn,
    response: Response,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> dict[str, Any]:
    """One answer on many boxes: one act, one undo."""
    dataset = DatasetRepository(session).named(body.dataset)
    boxes = _boxes(body, services, session, dataset)
    answer = reviews.Answer(body.verdict, body.comment, audit.name)
    stored = reviews.review_many(session, dataset, boxes, answer)
    audit.note(
        Act.ANSWERS_GIVEN,
        stored.batch.id,
        dataset=dataset.name,
        verdict=body.verdict,
        answers=stored.answered,
        skipped=len(stored.skipped) + len(stored.stale),
    )
    response.headers["Location"] = f"/api/v1/review-batches/{stored.batch.id}"
    return {
        "id": stored.batch.id,
        "dataset": dataset.name,
        "verdict": stored.batch.verdict,
        "count": stored.answered,
        "skipped": stored.skipped,
        "stale": stored.stale,
    }


def _boxes(
    body: BulkIn, services: ServiceContext, session: Session, dataset: Dataset
) -> list[SeenBoxes]:
    """The boxes that a body asks for, and as what they were seen."""
    if (body.box_ids is None) == (body.filter is None):
        raise Unprocessable("expected either box_ids or filter, found both or neither")
    if body.filter is not None:
        if body.snapshot is None or body.seen_revisions is not None:
            raise Unprocessable(
                "expected a filter with snapshot, which a list of its boxes has beside "
                "total if count=true is asked for, found it without snapshot or with "
                "seen_revisions",
            )
        wanted = selection_of(body.filter)
        ids = select_boxes(services, session, dataset, wanted, body.snapshot)
        boxes = [SeenBoxes(ids, None)]
    elif body.snapshot is not None:
        raise Unprocessable(
            "expected box_ids with seen_revisions, found them with snapshot, which "
            "belongs to a filter"
        )
    else:
        limit = services.settings.max_bulk_boxes
        boxes = reviews.listed_boxes(body.box_ids or [], body.seen_revisions, limit)
    found, expected = sum(len(seen.box_ids) for seen in boxes), body.expected_count
    if expected is not None and expected != found:
        what = "box_ids lists" if body.filter is None else "the filter selects"
        raise CountChanged(what, found=found, expected=expected)
    return boxes


@router.post("/review-batches/{batch_id}/undo", response_model=UndoOut)
def undo_bulk_review(
    batch_id: RowId, session: WriteSession, principal: CurrentPrincipal, audit: Audited
) -> dict[str, Any]:
    """Say again what was said before; where someone spoke since, leave it.

    Batches of others are undone by admins alone.
    """
    undo, undone, skipped = reviews.undo_batch(session, batch_id, principal)
    dataset = DatasetRepository(session).with_id(undo.dataset_id)
    audit.note(
        Act.ANSWERS_TAKEN_BACK,
        batch_id,
        dataset=dataset.name,
        batch=undo.id,
        answers=undone,
        skipped=len(skipped),
    )
    return {"id": undo.id, "undone": undone, "skipped": skipped}
