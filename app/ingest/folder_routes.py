"""The route that finds the frames in a dropped folder, without storing them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from typing import Annotated, Final

from anyio import CancelScope, to_thread
from fastapi import Query, Request, Response
from pydantic import AfterValidator
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from app.context import ServiceContext
from app.http.bodies import UntilStopped
from app.http.deps import AppServices, Reviewer, admission_of
from app.http.middleware import BODY_ALLOWANCE
from app.http.routing import ApiRouter, streamed_up_to
from app.incoming import HeldBytes
from app.ingest.batch import OpenBatches
from app.ingest.folder import MOST_LONGER, FolderTask, SentFolder, write_response
from app.ingest.routes import ARCHIVE_BODY, LINES, expect_archive, lines_of, until_left
from app.ingest.tar import TarLimits, TarStream
from app.storage.room import require_room
from filter_core.formats.recording import known_layouts
from unghost.wire.folders import (
    FolderEnd,
    FolderFrame,
    FolderHead,
    LayoutName,
    UnmatchedFile,
)


def _known_layout(name: str) -> str:
    """Checks a layout before the files are received; the server may have plug-ins."""
    known = known_layouts(name)
    if name not in known:
        raise ValueError(f"expected one of {', '.join(known)}")
    return name


router = ApiRouter(prefix="/api/v1", tag="frames")


@router.post(
    "/folders",
    response_class=Response,
    responses=lines_of(
        FolderHead,
        FolderFrame,
        UnmatchedFile,
        FolderEnd,
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
        LayoutName,
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
        sent = await run_in_threadpool(_new_folder, services)
        opened.push_async_callback(_remove, sent)
        await _receive(request, services, sent)
        task = FolderTask(
            root=sent.root,
            response=sent.response,
            layout=layout,
            refused=tuple(sent.refused),
            absent=tuple(sent.absent),
            most_bytes=MOST_LONGER * int(settings.max_folder_bytes),
        )
        size = await _in_child(request, services, task)
        return FolderResponse(sent.response, size, opened.pop_all())


def _new_folder(services: ServiceContext) -> SentFolder:
    settings = services.settings
    require_room(settings, services.storage)
    return SentFolder(
        services.storage.temporary_folder(),
        settings.max_folder_files,
        int(settings.max_part_bytes),
    )


async def _remove(sent: SentFolder) -> None:
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
        for member in archive.feed(chunk):
            sent.add(member)

    pieces = UntilStopped(request.stream(), stop)
    with stop.calling(pieces.wake):
        async for chunk in pieces:
            await run_in_threadpool(add_files, chunk)
            held.hold(archive.size_bytes)
    archive.close()
    held.hold(0)


async def _in_child(
    request: Request, services: ServiceContext, task: FolderTask
) -> int:
    """Let a child write the response; returns its size. Ends if the client leaves."""
    async with until_left(request) as cancelled:
        return await to_thread.run_sync(
            partial(services.folders.run, write_response, task, cancelled=cancelled),
            limiter=admission_of(request).folders,
        )


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
