"""Routes of frames, boxes, and pictures of both."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated

from anyio import to_thread
from fastapi import Query, Request, Response
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool

from app.access.gate import Audited
from app.boxes import frames
from app.boxes import reader as boxes
from app.boxes.counts import count_boxes
from app.boxes.drawing import PICTURES, Drawing, DrawnPictures
from app.boxes.filter import filters_of, to_filter
from app.boxes.queries import FrameRepository, PageRequest
from app.boxes.related import boxes_alike, track_of
from app.boxes.snapshot import take_snapshot
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db.engine import begin_as_work
from app.engine.children import CallCancelled, PixelsRefused
from app.errors import BadRequest
from app.http import files
from app.http.bodies import stopping
from app.http.deps import (
    AppServices,
    DatasetName,
    FrameKey,
    ReadSession,
    Reviewer,
    RowId,
    Viewer,
    admission_of,
    current_principal,
    make_room,
)
from app.http.pages import json_response, page_response, page_with_link
from app.http.routing import CLIENT_LEFT, ApiRouter, asks_for_head, has_left
from app.storage.base import BlobStore
from filter_core.values import similar
from unghost.wire import boxes as wire
from unghost.wire import frames as wire_frames
from unghost.wire.model import Page
from unghost.wire.words import TAR, FileKind


async def drawn_response(
    request: Request,
    services: ServiceContext,
    plan: Callable[[BlobStore, Session], Drawing],
    version: str = "",
) -> Response:
    """A picture, drawn unless the browser or the service has it cached.

    `plan` finds out what is to be drawn. With a `version` in its address, a browser may
    keep the picture without asking again.

    Each token gets all but one of the places for drawing; further requests wait without
    using a thread. Drawing is cancelled when the client disconnects or the service
    stops: the request can be repeated.
    """

    def planned() -> Drawing:
        with services.database.read() as session:
            return plan(services.storage, session)

    drawing = await run_in_threadpool(planned)
    headers = files.blob_headers(drawing.tag) | {
        "Cache-Control": files.IMMUTABLE if version else files.REVALIDATE
    }
    if files.is_known(request, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    if asks_for_head(request):  # drawing it just for its length would be a waste
        unknown = Response(media_type=drawing.media_type, headers=headers)
        del unknown.headers["content-length"]
        return unknown
    content = services.one(DrawnPictures).find(drawing.tag)
    if content is None:
        content = await _drawn(request, services, drawing)
    if content is None:
        return Response(status_code=CLIENT_LEFT)
    services.one(DrawnPictures).keep(drawing.tag, content)
    return Response(content, media_type=drawing.media_type, headers=headers)


async def _drawn(
    request: Request, services: ServiceContext, drawing: Drawing
) -> bytes | None:
    """The picture itself; None if the client has disconnected.

    Raises NotReady: the service is stopping.
    """
    cancelled, admission = threading.Event(), admission_of(request)

    async def draw() -> bytes:
        async with admission.drawing.of(current_principal(request).token_id):
            return await to_thread.run_sync(
                drawing.content,
                services.drawers,
                cancelled,
                services.settings.data / PICTURES,
                limiter=admission.drawings,
            )

    drawn = asyncio.ensure_future(draw())
    left = asyncio.ensure_future(has_left(request))
    stop = services.engine.stopping
    try:
        with stop.calling(cancelled.set):
            if stop.is_set():
                raise stopping()
            await asyncio.wait({drawn, left}, return_when=asyncio.FIRST_COMPLETED)
            return drawn.result() if drawn.done() else None
    except CallCancelled:
        raise stopping() from None
    except PixelsRefused as refused:
        services.one(DrawnPictures).refuse(drawing.tag, refused)
        raise
    finally:
        cancelled.set()
        drawn.cancel()
        left.cancel()
        await asyncio.wait({drawn, left})


router = ApiRouter(prefix="/api/v1", tag="boxes")

crops_router = ApiRouter(prefix="/api/v1", tag="boxes")


@router.get("/boxes", response_model=wire.BoxPage)
def list_boxes(
    caller: Viewer,
    request: Request,
    session: ReadSession,
    services: AppServices,
    query: Annotated[wire.BoxListQuery, Query()],
) -> Response:
    """Boxes of a dataset, sorted by id, doubt, match or crowding."""
    names = None if query.fields is None else _named(query.fields, wire.BOX_FIELDS)
    dataset = DatasetRepository(session).named(query.dataset)
    reader = boxes.DecisionReader(session, dataset)
    box_filter = to_filter(session, dataset, query)
    page = PageRequest(query.sort, query.cursor, query.limit)
    decisions, cursor = boxes.list_boxes(session, reader, box_filter, page)
    items: Sequence[Mapping[str, object]] = decisions
    if names is not None:
        items = [{name: box[name] for name in names} for box in items]
    if not query.count:
        return page_response(request, items, cursor)
    total = count_boxes(services, session, dataset, box_filter)
    snapshot = take_snapshot(session, dataset, query, total)
    return page_response(request, items, cursor, total=total, snapshot=snapshot)


@router.get("/boxes/table", response_model=wire.BoxTable)
def get_table(
    caller: Viewer,
    request: Request,
    session: ReadSession,
    query: Annotated[wire.BoxTableQuery, Query()],
) -> Response:
    """Boxes of a dataset as columns, frame by frame: for data frames and tables."""
    names = wire.USUAL_COLUMNS
    if query.fields is not None:
        names = _named(query.fields, wire.BOX_COLUMNS)
    dataset = DatasetRepository(session).named(query.dataset)
    reader = boxes.DecisionReader(session, dataset)
    box_filter = to_filter(session, dataset, query)
    columns, rows, cursor = boxes.table_of_boxes(
        session, reader, box_filter, names, PageRequest("id", query.cursor, query.limit)
    )
    table = {"columns": columns, "rows": rows, "next_cursor": cursor}
    return page_with_link(request, table, cursor)


def _named(fields: str, allowed: Sequence[str]) -> tuple[str, ...]:
    """The names of a parameter `fields`, in their order, each once.

    Raises BadRequest: ``unknown_field``: one is not known; the error names the nearest.
    """
    names = tuple(dict.fromkeys(name.strip() for name in fields.split(",")))
    for name in names:
        if name not in allowed:
            meant = similar(name, allowed)
            hint = f"; did you mean {meant!r}?" if meant else ""
            raise BadRequest(
                f"fields: expected some of {', '.join(allowed)}; found {name[:80]!r}"
                f"{hint}",
                code="unknown_field",
            )
    return names


@router.get(
    "/boxes/crops",
    response_class=Response,
    responses=files.picture_of(TAR),
    openapi_extra=files.TAGGED,
)
async def get_crops(
    caller: Viewer,
    request: Request,
    services: AppServices,
    query: Annotated[wire_frames.CropsQuery, Query()],
) -> Response:
    """The parts of frames around several boxes, as a tar of WebP files.

    Each is named as the query names it, such as `7-0.25-256.webp`; it is empty where a
    box or its picture does not exist. Those that cannot be drawn are missing; the route
    of the one crop says why. A page of small pictures needs few requests with it.
    """
    folder = services.settings.data / PICTURES
    plan = partial(frames.crops_of, crops=query, folder=folder)
    return await drawn_response(request, services, plan, query.v)


@router.get("/boxes/{box_id}", response_model=wire.Box)
def get_box(caller: Viewer, box_id: RowId, session: ReadSession) -> wire.Box:
    """A box, its decision, and the boxes that overlap it."""
    reader, stored_box = boxes.read_box(session, box_id)
    (decision,) = reader.records(stored_box)
    return wire.Box.model_validate({**decision, "neighbours": stored_box.neighbours(0)})


@router.get("/boxes/{box_id}/alike", response_model=wire.Alike)
def get_alike(caller: Viewer, box_id: RowId, session: ReadSession) -> Response:
    """Boxes without an answer of the same class, reason, cause, hider and band."""
    return json_response(boxes_alike(session, box_id))


@router.get("/boxes/{box_id}/track", response_model=wire.Track)
def get_track(caller: Viewer, box_id: RowId, session: ReadSession) -> Response:
    """The same object in the frames of its recording before and after."""
    return json_response({"items": track_of(session, box_id)})


@router.get("/boxes/{box_id}/slice", response_model=wire.DepthSlice)
def get_slice(
    caller: Viewer, box_id: RowId, session: ReadSession, services: AppServices
) -> wire.DepthSlice:
    """Where a box and the pixels in it are on the axis of depth."""
    depth_slice = frames.slice_of(services, session, box_id)
    bands = [wire.DepthBand(near=a, far=b, percent=c) for a, b, c in depth_slice.bands]
    return wire.DepthSlice(
        near=depth_slice.near,
        far=depth_slice.far,
        median=depth_slice.median,
        bands=tuple(bands),
    )


@crops_router.get(
    "/boxes/{box_id}/crop",
    response_class=Response,
    responses=files.WEBP,
    openapi_extra=files.TAGGED,
)
async def get_crop(
    caller: Viewer,
    request: Request,
    box_id: RowId,
    services: AppServices,
    query: Annotated[wire_frames.CropQuery, Query()],
) -> Response:
    """The part of the frame around a box as WebP."""
    plan = partial(frames.crop_of, box_id=box_id, query=query)
    return await drawn_response(request, services, plan, query.v)


pictures_router = ApiRouter(prefix="/api/v1", tag="frames")


@pictures_router.get(
    "/frames/{frame_id}/thumbnail",
    response_class=Response,
    responses=files.WEBP,
    openapi_extra=files.TAGGED,
)
async def get_thumbnail(
    caller: Viewer,
    request: Request,
    frame_id: RowId,
    services: AppServices,
    query: Annotated[wire_frames.ThumbnailQuery, Query()],
) -> Response:
    """The image as WebP, not wider than asked for."""

    def plan(storage: BlobStore, session: Session) -> Drawing:
        return frames.frame_pictures(storage, session, frame_id).thumbnail(query.width)

    return await drawn_response(request, services, plan, query.v)


@pictures_router.get(
    "/frames/{frame_id}/overlay",
    response_class=Response,
    responses=files.PICTURE,
    openapi_extra=files.TAGGED,
)
async def get_overlay(
    caller: Viewer,
    request: Request,
    frame_id: RowId,
    services: AppServices,
    query: Annotated[wire_frames.OverlayQuery, Query()],
) -> Response:
    """A layer of the frame with its boxes as WebP; without boxes, lossless PNG."""
    plan = partial(frames.overlay_of, frame_id=frame_id, query=query)
    return await drawn_response(request, services, plan)


@pictures_router.get(
    "/frames/{frame_id}/{kind}",
    response_class=Response,
    responses=files.FILE,
    openapi_extra=files.RESUMABLE,
)
def get_file(
    caller: Viewer,
    frame_id: RowId,
    kind: FileKind,
    request: Request,
    session: ReadSession,
    services: AppServices,
) -> Response:
    """A file of the frame, byte for byte as it was sent."""
    file = frames.frame_file(session, frame_id, kind)
    response = files.known_response(request, file.sha256)
    if response is not None:
        return response
    if asks_for_head(request):  # only a GET compares the content with its hash
        blob = services.storage.open(file.sha256, size_bytes=file.size_bytes)
        return files.file_response(request, blob, file.sha256, file.media_type)
    blob = services.storage.open_verified(file.sha256, size_bytes=file.size_bytes)
    return files.file_response(request, blob, file.sha256, file.media_type)


frames_router = ApiRouter(prefix="/api/v1", tag="frames")


@frames_router.get("/datasets/{dataset}/report", response_model=wire_frames.Report)
def get_report(caller: Viewer, dataset: DatasetName, session: ReadSession) -> Response:
    """Where the ghosts are: by distance, and the frames with the most of them."""
    dataset_row = DatasetRepository(session).named(dataset)
    return json_response(frames.report_of(session, dataset_row))


@frames_router.get(
    "/datasets/{dataset}/frames", response_model=Page[wire_frames.FrameSummary]
)
def list_frames(
    caller: Viewer,
    request: Request,
    dataset: DatasetName,
    session: ReadSession,
    query: Annotated[wire.FrameListQuery, Query()],
) -> Response:
    """Frames by key or id; with filters on boxes, only frames that have such a box."""
    dataset_row = DatasetRepository(session).named(dataset)
    boxes = to_filter(session, dataset_row, query) if filters_of(query) else None
    page = PageRequest(query.sort, query.cursor, query.limit)
    rows = FrameRepository(session).page(dataset_row.id, page, query.key, boxes)
    listed, following = rows[: query.limit], None
    if len(rows) > query.limit:
        last = listed[-1]
        following = last.key if query.sort.endswith("key") else str(last.id)
    items = frames.frame_summaries(session, dataset_row, listed)
    return page_response(request, items, following)


@frames_router.get(
    "/datasets/{dataset}/frames/{key:any}", response_model=wire_frames.Frame
)
def get_frame_by_key(
    caller: Viewer, dataset: DatasetName, key: FrameKey, session: ReadSession
) -> Response:
    """The newest revision of the frame under a key."""
    dataset_id = DatasetRepository(session).named(dataset).id
    frame = FrameRepository(session).current(dataset_id, key)
    return json_response(frames.describe_frame(session, frame.id))


@frames_router.delete("/datasets/{dataset}/frames/{key:any}", status_code=204)
def delete_frame(
    dataset: DatasetName,
    key: FrameKey,
    services: AppServices,
    caller: Reviewer,
    audit: Audited,
) -> Response:
    """Delete a frame with all revisions and answers; an admin, if others answered."""
    begin_as_work(audit.session)
    dataset_row = DatasetRepository(audit.session).named(dataset)
    frames.remove_frame(audit, caller, dataset_row, key)
    make_room(services, audit.session)
    return Response(status_code=204)


@frames_router.get("/frames/{frame_id}", response_model=wire_frames.Frame)
def get_frame(caller: Viewer, frame_id: RowId, session: ReadSession) -> Response:
    """A frame with its boxes, their evidence, decisions and answers."""
    return json_response(frames.describe_frame(session, frame_id))
