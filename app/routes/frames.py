"""Frames: taken in whole, listed, shown."""

from __future__ import annotations

import asyncio
import threading
from typing import Annotated

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, Path, Query, Request, Response
from starlette.requests import ClientDisconnect

from app.context import ServiceContext
from app.db.engine import begin_as_work
from app.engine.pixels import GivenUp
from app.http.bodies import stopping
from app.http.deps import (
    AppServices,
    Audited,
    CurrentPrincipal,
    ReadSession,
    RowId,
    make_room,
)
from app.http.pages import page_response, written
from app.http.routing import ApiRouter, has_left
from app.repositories.datasets import DatasetRepository
from app.repositories.frames import FrameFilter
from app.routes.datasets import DatasetName
from app.routes.frame_upload import ANNOTATION, FrameParts, described_body
from app.routes.selections import selection_of
from app.services import frames
from app.services.box_selection import to_filter
from app.services.frame_keys import checked_key
from app.services.ingest import FrameUpload, prepare_frame, store_frame
from unghost.wire.boxes import FrameListQuery
from unghost.wire.frames import Frame, FrameSummary, StoredFrame
from unghost.wire.model import Page

upload_router = ApiRouter(prefix="/api/v1", tag="frames")
router = ApiRouter(prefix="/api/v1", tag="frames")

FrameKey = Annotated[str, Path(max_length=2000)]


async def frame_upload(
    key: FrameKey,
    parts: FrameParts,
    principal: CurrentPrincipal,
    replace: Annotated[
        bool, Query(description="Store other content as the next revision.")
    ] = False,
) -> FrameUpload:
    """A frame as it was sent. Asynchronous: not worth a thread of its own."""
    files = {kind: content for kind, content in parts.items() if kind != ANNOTATION}
    return FrameUpload(checked_key(key), parts[ANNOTATION], files, principal, replace)


@upload_router.put(
    "/datasets/{dataset}/frames/{key:any}",
    status_code=201,
    response_model=StoredFrame,
    responses={200: {"model": StoredFrame, "description": "Stored already."}},
    openapi_extra=described_body(),
)
async def put_frame(
    request: Request,
    dataset: DatasetName,
    upload: Annotated[FrameUpload, Depends(frame_upload)],
    services: AppServices,
) -> Response:
    """Store a frame: measured, decided and durable before this is answered."""
    # One thread does all of it, out of some that only uploads have: the shared ones
    # might all wait for frames that take long, and to change threads costs as much as
    # to decide a frame.
    places: CapacityLimiter = request.app.state.uploads
    given_up = threading.Event()
    watching = asyncio.ensure_future(_tell_when_left(request, given_up))
    try:
        return await to_thread.run_sync(
            _store, services, dataset, upload, given_up, limiter=places
        )
    except GivenUp:
        raise (ClientDisconnect if given_up.is_set() else stopping)() from None
    finally:
        watching.cancel()


async def _tell_when_left(request: Request, given_up: threading.Event) -> None:
    await has_left(request)
    given_up.set()


def _store(
    services: ServiceContext,
    dataset: str,
    upload: FrameUpload,
    given_up: threading.Event,
) -> Response:
    ready = prepare_frame(services, dataset, upload, given_up)
    with services.database.write() as session:
        stored = store_frame(services, session, dataset, ready)
    # Made when others may write again: it takes as long as all the rows.
    if stored.describe is not None:
        answer = stored.describe()
    else:
        with services.database.read() as reading:
            answer = frames.describe_stored(reading, stored.frame_id)
    headers = {"Location": f"/api/v1/frames/{stored.frame_id}"}
    return written(answer, 201 if stored.created else 200, headers)


@router.get("/datasets/{dataset}/frames", response_model=Page[FrameSummary])
def list_frames(
    request: Request,
    dataset: DatasetName,
    session: ReadSession,
    query: Annotated[FrameListQuery, Query()],
) -> Response:
    """Frames by key or arrival; with filters on boxes, those that have such a box."""
    found = DatasetRepository(session).named(dataset)
    selection = selection_of(query)
    boxes = to_filter(session, found, selection) if selection.selects() else None
    rows, cursor = frames.page_of_frames(
        session,
        FrameFilter(found.id, query.key, boxes),
        frames.PageRequest(query.sort, query.cursor, query.limit),
    )
    return page_response(request, frames.frame_summaries(session, found, rows), cursor)


@router.get("/datasets/{dataset}/frames/{key:any}", response_model=Frame)
def get_frame_by_key(
    dataset: DatasetName, key: FrameKey, session: ReadSession
) -> Response:
    """The newest revision of the frame under a key."""
    frame_id = frames.frame_id_of(session, dataset, key)
    return written(frames.describe_frame(session, frame_id))


@router.delete("/datasets/{dataset}/frames/{key:any}", status_code=204)
def delete_frame(
    dataset: DatasetName,
    key: FrameKey,
    services: AppServices,
    principal: CurrentPrincipal,
    audit: Audited,
) -> Response:
    """Delete a frame with all its revisions and answers; others' need an admin."""
    begin_as_work(audit.session)
    found = DatasetRepository(audit.session).named(dataset)
    frames.remove_frame(audit, principal, found, key)
    make_room(services, audit.session)
    return Response(status_code=204)


@router.get("/frames/{frame_id}", response_model=Frame)
def get_frame(frame_id: RowId, session: ReadSession) -> Response:
    """A frame with its boxes, their evidence, decisions and answers."""
    return written(frames.describe_frame(session, frame_id))
