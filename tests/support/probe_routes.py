"""Routes that only tests add: they raise an error, write a row, stream or block."""

import asyncio
import errno
import os
import threading
from collections.abc import AsyncIterator

from fastapi import Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel
from sqlalchemy import func, select, text
from sqlalchemy.exc import OperationalError

from app import errors
from app.db.tables.access import Token
from app.http.deps import Admin, ReadSession, Reviewer, RowId, Viewer
from app.http.files import file_response
from app.http.routing import LARGE_BODY, ApiRouter, OpenRouter, body_up_to
from app.http.transaction import WriteSession
from app.storage.base import StoredBlob
from filter_core.errors import AnnotationError, AnnotationErrors

router = ApiRouter(prefix="/probe")
open_router = OpenRouter(prefix="/open")
endless_response_stopped = threading.Event()
"""Set when the service stops sending an endless response."""
both_requests_arrived = threading.Barrier(2, timeout=30)
is_held = threading.Event()
unblock = threading.Event()
"""Tests clear it to make `hold` and `wait` block."""
unblock.set()
waiting = threading.Semaphore(0)

RAISED: dict[str, Exception] = {
    "bad-request": errors.BadRequest("the cursor is damaged"),
    "conflict": errors.FrameConflict("frame 'a' holds another image"),
    "stale": errors.StaleReview(box_id=7, seen=1, found=2, current={"box_id": 7}),
    "range": errors.RangeNotSatisfiable(size_bytes=10),
    "missing": errors.NotFound("dataset", "town10"),
    "quota": errors.TooManyRequests("100 runs wait already", retry_after_s=60),
    "filter": AnnotationErrors(
        [
            AnnotationError("box 0 ('a') is inside out", pointer="/boxes/0/xyxy"),
            AnnotationError("box 2 ('c') has no class", pointer="/boxes/2"),
        ]
    ),
    "busy": OperationalError("select 1", {}, Exception("database is locked")),
    "full": OperationalError("insert", {}, Exception("database or disk is full")),
    "many-files": OSError(errno.EMFILE, os.strerror(errno.EMFILE)),
    "away": OperationalError("select 1", {}, Exception("could not connect")),
    "internal": RuntimeError("the secret is hunter2"),
}


class Note(BaseModel):
    """The body of a request."""

    name: str
    count: int = 0


@router.get("/raise/{name}")
def raise_one(caller: Viewer, name: str) -> None:
    raise RAISED[name]


@router.get("/items/{item_id}")
def item(caller: Viewer, item_id: RowId, limit: int = 100) -> dict[str, int]:
    return {"item_id": item_id, "limit": limit}


@router.post("/tokens", status_code=201)
def add_token(caller: Reviewer, body: Note, session: WriteSession) -> dict[str, str]:
    """Add a token whose row is written at the commit, which may fail."""
    session.add(Token(name=body.name, role="viewer", hash=body.name))
    return {"stored": body.name}


@router.post("/slow", status_code=201)
def add_slowly(caller: Reviewer, body: Note, session: WriteSession) -> dict[str, int]:
    """Write only once two requests have come this far at the same time."""
    both_requests_arrived.wait()
    session.execute(
        text(
            "insert into tokens (name, role, hash, created_at) values (:n, 'viewer',"
            " :n, '2026-01-01')"
        ),
        {"n": body.name},
    )
    return {"tokens": session.scalar(select(func.count()).select_from(Token)) or 0}


@router.get("/tokens/count")
def count_tokens(caller: Viewer, session: ReadSession) -> int:
    return session.scalar(select(func.count()).select_from(Token)) or 0


@router.post("/tokens/early", status_code=201)
def add_early(caller: Reviewer, body: Note, session: WriteSession) -> Note:
    """Add a token at once, and so hold the write lock until the commit."""
    session.add(Token(name=body.name, role="viewer", hash=body.name))
    session.flush()
    return body


@router.post("/tokens/copies", status_code=201)
def add_copy(caller: Reviewer, body: Note, session: WriteSession) -> dict[str, str]:
    return add_token(caller, body, session)


@router.post("/echo", openapi_extra=body_up_to("max_body_bytes"))
async def echo(caller: Reviewer, request: Request) -> int:
    return len(await request.body())


@router.post("/stream", openapi_extra=LARGE_BODY)
async def stream(caller: Reviewer, request: Request) -> int:
    return sum([len(part) async for part in request.stream()])


@router.get("/endless")
async def endless(caller: Viewer) -> StreamingResponse:
    async def pieces() -> AsyncIterator[bytes]:
        try:
            while True:
                yield bytes(65536)
                await asyncio.sleep(0)
        finally:
            endless_response_stopped.set()

    return StreamingResponse(pieces())


@router.get("/hold")
async def hold(caller: Viewer) -> str:
    """Block the event loop, as no real route may."""
    is_held.set()
    unblock.wait(60)
    return "gone on"


@router.get("/wait")
@router.post("/wait", name="wait_as_a_write")
def wait(caller: Reviewer) -> str:
    """Block a thread."""
    return wait_openly()


@open_router.get("/wait")
def wait_openly() -> str:
    """Block a thread, for anybody."""
    waiting.release()
    unblock.wait(60)
    return "gone on"


@router.post("/wait/to-write")
def wait_to_write(caller: Reviewer, _session: WriteSession) -> str:
    """Block a thread, with a place among the requests that write."""
    return wait_openly()


@router.get("/large-file")
async def large_file(caller: Viewer, request: Request) -> Response:
    path = request.app.state.large_file
    blob = StoredBlob(path.stat().st_size, lambda first, end: b"", path)
    return file_response(request, blob, "0" * 64, "application/octet-stream")


@router.post("/admin-only")
def admin_only(caller: Admin) -> str:
    return caller.name


@open_router.get("/hello")
def hello() -> str:
    return "hello"
