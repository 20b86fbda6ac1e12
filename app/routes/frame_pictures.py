"""The files of a frame as they were sent, and pictures drawn from them."""

from __future__ import annotations

from enum import Enum
from typing import Annotated

from fastapi import Depends, Query, Request, Response

from app.http.deps import AppServices, ReadSession, RowId
from app.http.routing import ApiRouter, asks_for_head
from app.routes.blobs import drawn_response, file_response, known_response
from app.schemas.pictures import FILE, JPEG, PICTURE, RESUMABLE, TAGGED
from app.services.drawing import DrawnBox
from app.services.frames import decisions_of, frame_file
from app.services.pictures import Drawing, frame_pictures
from unghost.wire.frames import OverlayQuery

router = ApiRouter(prefix="/api/v1", tag="frames")


class FileKind(str, Enum):
    """A file that a frame can have."""

    IMAGE = "image"
    SEGMENTATION = "segmentation"
    DEPTH = "depth"
    INSTANCES = "instances"
    LIDAR = "lidar"
    RADAR = "radar"


def _thumbnail(frame_id: RowId, services: AppServices) -> Drawing:
    with services.database.read() as session:
        return frame_pictures(services.storage, session, frame_id).thumbnail()


@router.get(
    "/frames/{frame_id}/thumbnail",
    response_class=Response,
    responses=JPEG,
    openapi_extra=TAGGED,
)
async def get_thumbnail(
    request: Request,
    services: AppServices,
    drawing: Annotated[Drawing, Depends(_thumbnail)],
) -> Response:
    """A small JPEG of the image."""
    return await drawn_response(request, services, drawing)


def _overlay(
    frame_id: RowId, services: AppServices, query: Annotated[OverlayQuery, Query()]
) -> Drawing:
    wanted = query.verdicts()
    with services.database.read() as session:
        found = frame_pictures(services.storage, session, frame_id)
        shown = decisions_of(session, frame_id) if wanted else []
    boxes = [
        DrawnBox(one["effective_verdict"], one["xyxy"], one["edges"])
        for one in shown
        if one["effective_verdict"] in wanted
    ]
    return found.overlay(query.layer, boxes, edges=query.edges == "3d")


@router.get(
    "/frames/{frame_id}/overlay",
    response_class=Response,
    responses=PICTURE,
    openapi_extra=TAGGED,
)
async def get_overlay(
    request: Request,
    services: AppServices,
    drawing: Annotated[Drawing, Depends(_overlay)],
) -> Response:
    """A layer of the frame with its boxes as JPEG; without boxes, lossless PNG."""
    return await drawn_response(request, services, drawing)


@router.get(
    "/frames/{frame_id}/{kind}",
    response_class=Response,
    responses=FILE,
    openapi_extra=RESUMABLE,
)
def get_file(
    frame_id: RowId,
    kind: FileKind,
    request: Request,
    session: ReadSession,
    services: AppServices,
) -> Response:
    """A file of the frame, byte for byte as it was sent."""
    file = frame_file(session, frame_id, kind.value)
    known = known_response(request, file.sha256)
    if known is not None:
        return known
    if asks_for_head(request):  # its content is compared with its hash by a GET
        blob = services.storage.whole(file.sha256, size_bytes=file.size_bytes)
        return file_response(request, blob, file.sha256, file.media_type)
    blob = services.storage.intact(file.sha256, size_bytes=file.size_bytes)
    return file_response(request, blob, file.sha256, file.media_type)
