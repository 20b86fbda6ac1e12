"""Boxes: lists in the orders people review in, one box, its crop and its history."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query, Request, Response

from app.deps import AppServices, ReadSession, RowId
from app.repositories.datasets import DatasetRepository
from app.routes.blobs import drawn_response
from app.routes.selections import selection_of
from app.routing import ApiRouter
from app.schemas.boxes import BoxListQuery, BoxOut, BoxPage
from app.schemas.pages import page_response
from app.schemas.pictures import JPEG, TAGGED, CropQuery
from app.schemas.reviews import HistoryOut
from app.services import boxes
from app.services.box_counts import count_boxes
from app.services.box_selection import to_filter
from app.services.history import history
from app.services.pictures import crop, frame_pictures, visible_rectangle

router = ApiRouter(prefix="/api/v1", tag="boxes")


@router.get("/boxes", response_model=BoxPage)
def list_boxes(
    request: Request,
    session: ReadSession,
    services: AppServices,
    query: Annotated[BoxListQuery, Query()],
) -> Response:
    """Boxes of a dataset by id, doubt, match or crowding."""
    dataset = DatasetRepository(session).named(query.dataset)
    wanted = to_filter(session, dataset, selection_of(query))
    page = boxes.PageRequest(query.sort, query.cursor or "", query.limit)
    items, cursor = boxes.list_boxes(session, dataset, wanted, page)
    total = None
    if query.count:
        total = count_boxes(services, session, dataset, wanted)
    return page_response(request, items, cursor, total=total)


@router.get("/boxes/{box_id}", response_model=BoxOut)
def get_box(box_id: RowId, session: ReadSession) -> dict[str, Any]:
    """A box, its decision, and the boxes that overlap it."""
    return boxes.with_neighbours(session, box_id)


@router.get("/boxes/{box_id}/history", response_model=HistoryOut)
def get_history(box_id: RowId, session: ReadSession) -> dict[str, Any]:
    """Decisions of runs and answers of people on a box, newest first."""
    return {"items": history(session, box_id)}


@router.get(
    "/boxes/{box_id}/crop",
    response_class=Response,
    responses=JPEG,
    openapi_extra=TAGGED,
)
def get_crop(
    box_id: RowId,
    request: Request,
    session: ReadSession,
    services: AppServices,
    query: Annotated[CropQuery, Query()],
) -> Response:
    """The part of the frame around a box as JPEG."""
    decision = boxes.describe_box(session, box_id)
    found = frame_pictures(services.storage, session, decision["frame_id"])
    xyxy = visible_rectangle(decision)
    tag = found.tag("crop", xyxy, *query.model_dump().values())
    return drawn_response(
        request,
        tag,
        "image/jpeg",
        lambda: crop(found.layer(query.layer), xyxy, query.pad, query.height),
    )
