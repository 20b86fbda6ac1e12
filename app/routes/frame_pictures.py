"""The files of a frame as they were sent, and pictures drawn from them."""

from __future__ import annotations

from enum import Enum
from typing import Annotated

from fastapi import Query, Request, Response

from app.deps import AppServices, ReadSession, RowId
from app.errors import NotFound
from app.routes.blobs import drawn_response, file_response
from app.routing import ApiRouter
from app.schemas.pictures import FILE, JPEG, PICTURE, RESUMABLE, TAGGED, OverlayQuery
from app.services.frames import describe_frame, frame_file
from app.services.pictures import frame_pictures, overlay, thumbnail

router = ApiRouter(prefix="/api/v1", tag="frames")


class FileKind(str, Enum):
    """A file that a frame can have."""

    IMAGE = "image"
    SEGMENTATION = "segmentation"
    DEPTH = "depth"
    INSTANCES = "instances"
    LIDAR = "lidar"
    RADAR = "radar"


@router.get(
    "/frames/{frame_id}/thumbnail",
    response_class=Response,
    responses=JPEG,
    openapi_extra=TAGGED,
)
def get_thumbnail(
    frame_id: RowId, request: Request, session: ReadSession, services: AppServices
) -> Response:
    """A small JPEG of the image."""
    found = frame_pictures(services.storage, session, frame_id)
    if "image" not in found.files:
        raise NotFound("image of frame", frame_id)
    digest = found.files["image"].sha256
    return drawn_response(
        request,
        f"{digest}-thumbnail",
        "image/jpeg",
        lambda: thumbnail(services.storage.read(digest)),
    )


@router.get(
    "/frames/{frame_id}/overlay",
    response_class=Response,
    responses=PICTURE,
    openapi_extra=TAGGED,
)
def get_overlay(
    frame_id: RowId,
    request: Request,
    session: ReadSession,
    services: AppServices,
    query: Annotated[OverlayQuery, Query()],
) -> Response:
    """A layer of the frame with its boxes as JPEG; without boxes, lossless PNG."""
    found = frame_pictures(services.storage, session, frame_id)
    wanted = query.verdicts()
    shown = describe_frame(session, frame_id)["boxes"] if wanted else []
    drawn = [one for one in shown if one["effective_verdict"] in wanted]
    lines = [(one["effective_verdict"], one["xyxy"], one["edges"]) for one in drawn]
    return drawn_response(
        request,
        found.tag("overlay", query.layer, query.edges, lines),
        "image/jpeg" if drawn else "image/png",
        lambda: overlay(found.layer(query.layer), drawn, edges=query.edges == "3d"),
    )


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
    blob = services.storage.intact(file.sha256, size_bytes=file.size_bytes)
    return file_response(request, blob, file.sha256, file.media_type)
