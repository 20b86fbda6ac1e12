"""Boxes: lists in the orders people review in, one box, its crop and its history."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query, Request, Response

from app.http.deps import AppServices, ReadSession, RowId
from app.http.pages import page_response
from app.http.routing import ApiRouter
from app.repositories.datasets import DatasetRepository
from app.routes.blobs import drawn_response
from app.routes.selections import selection_of
from app.schemas.pictures import JPEG, TAGGED
from app.services import boxes
from app.services.box_counts import count_boxes
from app.services.box_selection import to_filter
from app.services.bulk_selection import take_snapshot
from app.services.history import history
from app.services.pictures import Drawing, frame_pictures, visible_rectangle
from unghost.wire.boxes import Box, BoxListQuery, BoxPage, History
from unghost.wire.frames import CropQuery

router = ApiRouter(prefix="/api/v1", tag="boxes")
history_router = ApiRouter(prefix="/api/v1", tag="boxes")
crops_router = ApiRouter(prefix="/api/v1", tag="boxes")


@router.get("/boxes", response_model=BoxPage)
def list_boxes(
    request: Request,
    session: ReadSession,
    services: AppServices,
    query: Annotated[BoxListQuery, Query()],
) -> Response:
    """Boxes of a dataset by id, doubt, match or crowding."""
    dataset = DatasetRepository(session).named(query.dataset)
    selection = selection_of(query)
    wanted = to_filter(session, dataset, selection)
    page = boxes.PageRequest(query.sort, query.cursor or "", query.limit)
    items, cursor = boxes.list_boxes(session, dataset, wanted, page)
    if not query.count:
        return page_response(request, items, cursor)
    total = count_boxes(services, session, dataset, wanted)
    snapshot = take_snapshot(session, dataset, selection, total)
    return page_response(request, items, cursor, total=total, snapshot=snapshot)


@router.get("/boxes/{box_id}", response_model=Box)
def get_box(box_id: RowId, session: ReadSession) -> boxes.NeighbouredDecision:
    """A box, its decision, and the boxes that overlap it."""
    return boxes.with_neighbours(session, box_id)


@history_router.get(
    "/boxes/{box_id}/history",
    response_model=History,
    response_model_exclude_unset=True,
)
def get_history(box_id: RowId, session: ReadSession) -> History:
    """Decisions of runs and answers of people on a box, newest first."""
    return History(items=tuple(history(session, box_id)))


def _crop(
    box_id: RowId, services: AppServices, query: Annotated[CropQuery, Query()]
) -> Drawing:
    with services.database.read() as session:
        decision = boxes.describe_box(session, box_id)
        found = frame_pictures(services.storage, session, decision["frame_id"])
    xyxy = visible_rectangle(decision)
    return found.crop(query.layer, xyxy, query.pad, query.height)


@crops_router.get(
    "/boxes/{box_id}/crop",
    response_class=Response,
    responses=JPEG,
    openapi_extra=TAGGED,
)
async def get_crop(
    request: Request,
    services: AppServices,
    drawing: Annotated[Drawing, Depends(_crop)],
) -> Response:
    """The part of the frame around a box as JPEG."""
    return await drawn_response(request, services, drawing)
