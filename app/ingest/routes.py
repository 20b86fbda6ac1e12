"""Routes that store frames, look up stored keys, and read a dropped folder."""

from __future__ import annotations

import asyncio
import json
import threading
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Final

from anyio import CancelScope, to_thread
from fastapi import Depends, Query, Request, Response
from pydantic import AfterValidator
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from app.boxes import frames
from app.catalog.datasets import DatasetRepository
from app.catalog.frames import key_rows
from app.context import ServiceContext
from app.engine.children import CallCancelled
from app.errors import Unprocessable, UnsupportedMedia
from app.http.bodies import UntilStopped, read_parts, stopping
from app.http.deps import (
    AppServices,
    DatasetName,
    FrameKey,
    ReadSession,
    Reviewer,
    admission_of,
    services_of,
    settings_of,
)
from app.http.middleware import BODY_ALLOWANCE
from app.http.pages import json_response
from app.http.problems import refusal_of
from app.http.routing import LARGE_BODY, ApiRouter, body_up_to, has_left, streamed_up_to
from app.incoming import HeldBytes
from app.ingest.batch import ArchiveFrames, BatchIntake, OpenBatches
from app.ingest.check import KINDS
from app.ingest.folder import MOST_LONGER, SentFolder, write_response
from app.ingest.frame import EndedFrame, RefusedFrame, UploadedFrame, UploadRequest
from app.ingest.rows import NewFrame
from app.ingest.service import add_frame
from app.ingest.tar import TarLimits, TarStream
from app.logs import current_request_id
from app.measuring.active import PlanCache
from app.storage.room import require_room
from filter_core.formats.recording import known_layouts
from unghost.wire import folders
from unghost.wire import frames as wire
from unghost.wire.model import Problem, ResponseModel
from unghost.wire.words import TAR

LINES: Final = "application/x-ndjson"

router = ApiRouter(prefix="/api/v1", tag="frames")
known_frames_router = ApiRouter(prefix="/api/v1", tag="frames")
folders_router = ApiRouter(prefix="/api/v1", tag="frames")

ARCHIVE_BODY: Final = {
    "requestBody": {
        "required": True,
        "content": {TAR: {"schema": {"type": "string", "format": "binary"}}},
    }
}


def lines_of(
    *models: type[ResponseModel], description: str
) -> dict[int | str, dict[str, object]]:
    """An OpenAPI response of lines of JSON, each line one of these models."""
    kinds = [{"$ref": f"#/components/schemas/{model.__name__}"} for model in models]
    content = {LINES: {"itemSchema": {"anyOf": kinds}}}
    return {200: {"content": content, "description": description}}


async def upload_request(
    dataset: DatasetName,
    caller: Reviewer,
    replace: Annotated[
        bool, Query(description="Store other content as the next revision.")
    ] = False,
) -> UploadRequest:
    """The parameters of all frames of a request. Async: not worth a thread."""
    return UploadRequest(dataset, caller, replace)


CommonToFrames = Annotated[UploadRequest, Depends(upload_request)]


@router.post(
    "/datasets/{dataset}/batches",
    response_class=Response,
    responses=lines_of(
        wire.BatchLine,
        wire.BatchEnd,
        description="A line per frame as soon as it is stored, and a last one.",
    ),
    openapi_extra={**LARGE_BODY, **ARCHIVE_BODY},
)
async def post_batch(
    caller: Reviewer, request: Request, common: CommonToFrames, services: AppServices
) -> Response:
    """Store the frames of a streamed tar; each is reported once it is durable."""
    expect_archive(request)
    return BatchResponse(request, services, common)


def expect_archive(request: Request) -> None:
    """Refuse a body whose headers do not declare a plain tar."""
    media_type = request.headers.get("content-type", "")
    if media_type.partition(";")[0].strip().lower() != TAR:
        raise UnsupportedMedia(
            f"expected {TAR}, found {media_type or 'no media type'!r}"
        )
    coding = request.headers.get("content-encoding", "identity")
    if coding.lower() != "identity":
        raise UnsupportedMedia(
            f"expected a body without Content-Encoding, found {coding[:80]!r}; images "
            "are compressed already"
        )


class BatchResponse(Response):
    """A response that reads the request while it is sent; nothing else may read it."""

    media_type = LINES

    def __init__(
        self, request: Request, services: ServiceContext, common: UploadRequest
    ) -> None:
        super().__init__()
        del self.headers["content-length"]
        self._request, self._services, self._common = request, services, common

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response; a fault before the first frame has a status of its own."""
        services = self._services
        with services.one(OpenBatches).enter(services.settings):
            await run_in_threadpool(self._require_dataset)
            stop = services.engine.stopping
            pieces = UntilStopped(self._request.stream(), stop)
            with stop.calling(pieces.wake):
                held: HeldBytes = scope[BODY_ALLOWANCE].held
                frames = ArchiveFrames(services.settings, pieces, held)
                await frames.begin()
                await self._respond(frames, send)

    async def _respond(self, frames: ArchiveFrames, send: Send) -> None:
        await send(
            {
                "type": "http.response.start",
                "status": self.status_code,
                "headers": self.raw_headers,
            }
        )
        async for lines in self._lines(frames):
            await send({"type": "http.response.body", "body": lines, "more_body": True})
        await send({"type": "http.response.body", "body": b""})

    def _require_dataset(self) -> None:
        require_room(self._services.settings, self._services.storage)
        with self._services.database.read() as session:
            self._services.one(PlanCache).active(session, self._common.dataset)

    async def _lines(self, frames: ArchiveFrames) -> AsyncIterator[bytes]:
        places = admission_of(self._request).batches
        intake = BatchIntake(self._services, self._common, places)
        counts: Counter[str] = Counter(stored=0, same=0, refused=0)
        why: dict[str, Problem] = {}
        try:
            async for ended in intake.ended(aiter(frames)):
                yield b"".join([self._line_of(frame, counts) for frame in ended])
                del ended  # free them while waiting for the next
        except ClientDisconnect:
            return  # the response cannot be delivered
        except Exception as error:
            why["problem"] = self._problem(error)
        yield _line(wire.BatchEnd(end=True, frames=counts.total(), **why, **counts))

    def _line_of(self, frame: EndedFrame, counts: Counter[str]) -> bytes:
        """The line of a frame; also counts the frame."""
        if isinstance(frame, RefusedFrame):
            status, kind = refusal_of(frame.error).status, "refused"
            line = wire.BatchLine(
                key=frame.key,
                status=status,
                frame_id=None,
                decisions=None,
                answers_set_aside=0,
                boxes_set_aside=(),
                problem=self._problem(frame.error),
            )
        else:
            is_new = isinstance(frame, NewFrame)
            status, kind = (201, "stored") if is_new else (200, "same")
            notes = frame.ready.measured.notes if isinstance(frame, NewFrame) else ()
            line = wire.BatchLine(
                key=frame.key,
                status=status,
                frame_id=frame.frame_id,
                decisions=frame.verdicts,
                answers_set_aside=frame.answers_set_aside,
                boxes_set_aside=frame.boxes_set_aside,
                **({"notes": notes} if notes else {}),
            )
        self._request.app.state.metrics.observe_frame(status)
        counts[kind] += 1
        return _line(line)

    def _problem(self, error: Exception) -> Problem:
        return refusal_of(error).problem(
            instance=self._request.url.path, request_id=current_request_id.get()
        )


def _line(line: wire.BatchLine | wire.BatchEnd) -> bytes:
    fields = line.model_dump(mode="json")
    return json.dumps(fields, ensure_ascii=False).encode() + b"\n"


ANNOTATION: Final = "annotation"
_MEDIA_TYPE: Final = "multipart/form-data"


async def frame_parts(request: Request) -> dict[str, bytes]:
    """The parts of an upload by name; always with an annotation."""
    media_type = request.headers.get("content-type", "")
    if media_type.partition(";")[0].strip().lower() != _MEDIA_TYPE:
        raise UnsupportedMedia(
            f"expected {_MEDIA_TYPE}, found {media_type or 'no media type'!r}"
        )
    settings = settings_of(request)
    require_room(settings, services_of(request).storage)
    parts: dict[str, bytes] = {}
    for name, content in await read_parts(
        media_type,
        request.stream(),
        max_parts=settings.max_parts,
        max_part_bytes=settings.max_part_bytes,
    ):
        if name not in (ANNOTATION, *KINDS):
            raise Unprocessable(
                f"unknown part {name!r}; expected {ANNOTATION}, {', '.join(KINDS)}",
                code="unknown_part",
            )
        if name in parts:
            raise Unprocessable(f"part {name!r} was sent twice", code="repeated_part")
        parts[name] = content
    if ANNOTATION not in parts:
        raise Unprocessable(
            f"expected a part {ANNOTATION!r} with the frame's JSON, found "
            f"{', '.join(parts) or 'no part'}",
            code="missing_annotation",
        )
    return parts


FrameParts = Annotated[dict[str, bytes], Depends(frame_parts)]


def described_body() -> dict[str, object]:
    """The body for the OpenAPI document, which FastAPI cannot derive, and its limit.

    `OpenRoute` enforces the limit.
    """
    binary = {"type": "string", "format": "binary"}
    properties: dict[str, object] = {
        kind: {**binary, "description": f"The frame's file {kind!r}."} for kind in KINDS
    }
    properties[ANNOTATION] = {
        "$ref": "#/components/schemas/Annotation",
        "description": "Boxes, camera and more, as JSON.",
    }
    schema = {"type": "object", "properties": properties, "required": [ANNOTATION]}
    encoding = {ANNOTATION: {"contentType": "application/json"}}
    content = {_MEDIA_TYPE: {"schema": schema, "encoding": encoding}}
    body = {"requestBody": {"required": True, "content": content}}
    return {**body, **body_up_to("max_body_bytes")}


upload_router = ApiRouter(prefix="/api/v1", tag="frames")


async def frame_upload(key: FrameKey, parts: FrameParts) -> UploadedFrame:
    """A frame as it was sent. Async: not worth a thread."""
    files = {kind: content for kind, content in parts.items() if kind != ANNOTATION}
    return UploadedFrame(key, parts[ANNOTATION], files)


@upload_router.put(
    "/datasets/{dataset}/frames/{key:any}",
    status_code=201,
    response_model=wire.StoredFrame,
    responses={200: {"model": wire.StoredFrame, "description": "Stored already."}},
    openapi_extra=described_body(),
)
async def put_frame(
    caller: Reviewer,
    request: Request,
    common: CommonToFrames,
    upload: Annotated[UploadedFrame, Depends(frame_upload)],
    services: AppServices,
) -> Response:
    """Store a frame: it is measured, decided and durable before the response."""
    # One thread does all of it, as changing threads takes as long as deciding a frame.
    # It is one of a few for uploads alone: slow frames could occupy all shared ones.
    places = admission_of(request).uploads
    async with until_left(request) as cancelled:

        def store() -> Response:
            if cancelled.is_set():  # while the request waited for its place
                raise CallCancelled
            stored = add_frame(services, common, upload, cancelled)
            headers = {"Location": f"/api/v1/frames/{stored.frame_id}"}
            if isinstance(stored, NewFrame):
                # After the transaction, since it takes as long as inserting all rows.
                return json_response(stored.describe(), 201, headers)
            with services.database.read() as session:
                described = frames.describe_stored(session, stored.frame_id)
            return json_response(described, 200, headers)

        return await to_thread.run_sync(store, limiter=places)


@asynccontextmanager
async def until_left(request: Request) -> AsyncIterator[threading.Event]:
    """An event that is set when the client disconnects, so that work can be cancelled.

    Raises ClientDisconnect: the work was cancelled (`CallCancelled`), as the client has
    left; NotReady: the work was cancelled, as the service stops.
    """

    async def watch() -> None:
        await has_left(request)
        cancelled.set()

    cancelled = threading.Event()
    watching = asyncio.ensure_future(watch())
    try:
        yield cancelled
    except CallCancelled:
        raise (ClientDisconnect if cancelled.is_set() else stopping)() from None
    finally:
        watching.cancel()


@known_frames_router.post(
    "/datasets/{dataset}/known-frames", response_model=wire.KnownFrames
)
def find_known_frames(
    caller: Reviewer,
    dataset: DatasetName,
    body: wire.KnownFramesIn,
    session: ReadSession,
) -> wire.KnownFrames:
    """Which of up to 1000 keys are stored, each with the digest of its content."""
    dataset_row = DatasetRepository(session).named(dataset)
    known_frames = tuple(
        wire.KnownFrame(key=key, frame_id=row.frame_id, digest=row.content_digest)
        for key, row in sorted(key_rows(session, dataset_row.id, body.keys).items())
        if row.frame_id is not None and row.content_digest is not None
    )
    return wire.KnownFrames(items=known_frames)


def _known_layout(name: str) -> str:
    """Checks a layout before the files are received; the server may have plug-ins."""
    layouts = known_layouts(name)
    if name not in layouts:
        raise ValueError(f"expected one of {', '.join(layouts)}")
    return name


@folders_router.post(
    "/folders",
    response_class=Response,
    responses=lines_of(
        folders.FolderHead,
        folders.FolderFrame,
        folders.UnmatchedFile,
        folders.FolderEnd,
        description="A line about the folder, one per frame, one per file that belongs "
        "to no frame, and a last line with the inspection.",
    ),
    openapi_extra={**streamed_up_to("max_folder_bytes"), **ARCHIVE_BODY},
)
async def read_folder(
    caller: Reviewer,
    request: Request,
    services: AppServices,
    layout: Annotated[
        folders.LayoutName,
        AfterValidator(_known_layout),
        Query(description="How the files of the folder are arranged."),
    ] = "auto",
) -> Response:
    """List the frames in a folder and inspect it, without storing them.

    The body is a tar of its files: labels and lists as they are; of each kind of image
    some whole, for evenly spread frames, which are looked at; the others without
    content, or, where the size matters (KITTI's `image_2`), with the first 24 bytes of
    a PNG or 64 KiB of a JPEG. A `recording.yaml` in the folder says how it is read; as
    JSON, too. A folder that cannot be read has no frames, and its inspection says why.
    """
    expect_archive(request)
    settings = services.settings
    async with AsyncExitStack() as opened:
        opened.enter_context(services.one(OpenBatches).enter(settings))
        sent = await opened.enter_async_context(_sent_folder(services))
        await _receive(request, services, sent)
        most_bytes = MOST_LONGER * int(settings.max_folder_bytes)
        read = partial(services.folders.run, write_response, sent, layout, most_bytes)
        async with until_left(request) as cancelled:
            size = await to_thread.run_sync(
                partial(read, cancelled=cancelled),
                limiter=admission_of(request).folders,
            )
        return FolderResponse(sent.response, size, opened.pop_all())


@asynccontextmanager
async def _sent_folder(services: ServiceContext) -> AsyncIterator[SentFolder]:
    """A temporary folder for the files of a request, deleted when the block ends."""
    settings, storage = services.settings, services.storage
    limits = settings.max_folder_files, int(settings.max_part_bytes)

    def new() -> SentFolder:
        require_room(settings, storage)
        return SentFolder(storage.temporary_folder(), *limits)

    sent = await run_in_threadpool(new)
    try:
        yield sent
    finally:
        with CancelScope(shield=True):
            await run_in_threadpool(sent.remove)


async def _receive(
    request: Request, services: ServiceContext, sent: SentFolder
) -> None:
    """Write the files of the body to the folder while they are received."""
    settings, stop = services.settings, services.engine.stopping
    limits = TarLimits(
        max_archive_bytes=int(settings.max_folder_bytes),
        max_member_bytes=int(settings.max_part_bytes),
        # A long name is a member of its own, before the member that has it.
        max_members=2 * settings.max_folder_files,
    )
    archive = TarStream(limits, any_name=True)
    held: HeldBytes = request.scope[BODY_ALLOWANCE].held

    def add_files(chunk: bytes) -> None:
        for name, content in archive.feed(chunk):
            sent.add(name, content)

    pieces = UntilStopped(request.stream(), stop)
    with stop.calling(pieces.wake):
        async for chunk in pieces:
            await run_in_threadpool(add_files, chunk)
            held.hold(archive.size_bytes)
    archive.close()
    held.hold(0)


class FolderResponse(StreamingResponse):
    """A response from a temporary folder, which is deleted once it is sent or fails."""

    def __init__(self, file: Path, size: int, opened: AsyncExitStack) -> None:
        super().__init__(
            _pieces(file), media_type=LINES, headers={"Content-Length": str(size)}
        )
        self._opened = opened

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response, then delete the folder."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            await self._opened.aclose()


_PIECE: Final = 256 * 1024


def _pieces(file: Path) -> Iterator[bytes]:
    with file.open("rb") as stream:
        while piece := stream.read(_PIECE):
            yield piece
