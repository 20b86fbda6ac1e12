"""Routes that only tests have: each raises, stores or streams one thing."""

from __future__ import annotations

import threading

from fastapi import Request
from pydantic import BaseModel
from sqlalchemy import func, select, text
from sqlalchemy.exc import OperationalError

from app import errors
from app.db.access_tables import Token
from app.deps import ADMIN, CurrentPrincipal, ReadSession, RowId, WriteSession
from app.routing import LARGE_BODY, ApiRouter, OpenRouter
from filter_core.errors import AnnotationError, AnnotationErrors

router = ApiRouter(prefix="/probe")
open_router = OpenRouter(prefix="/open")
both_are_in = threading.Barrier(2, timeout=30)

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
    "away": OperationalError("select 1", {}, Exception("could not connect")),
    "internal": RuntimeError("the secret is hunter2"),
}


class Note(BaseModel):
    """A body."""

    name: str
    count: int = 0


@router.get("/raise/{name}")
def raise_one(name: str) -> None:
    raise RAISED[name]


@router.get("/items/{item_id}")
def item(item_id: RowId, limit: int = 100) -> dict[str, int]:
    return {"item_id": item_id, "limit": limit}


@router.post("/tokens", status_code=201)
def add_token(body: Note, session: WriteSession) -> dict[str, str]:
    """The row is only written by the commit, which may refuse it."""
    session.add(Token(name=body.name, role="viewer", hash=body.name))
    return {"stored": body.name}


@router.post("/slow", status_code=201)
def add_slowly(body: Note, session: WriteSession) -> dict[str, int]:
    """Writes when two requests have got this far at the same time."""
    both_are_in.wait()
    session.execute(
        text(
            "insert into tokens (name, role, hash, created_at) values (:n, 'viewer',"
            " :n, '2026-01-01')"
        ),
        {"n": body.name},
    )
    return {"tokens": session.scalar(select(func.count()).select_from(Token)) or 0}


@router.get("/tokens/count")
def count_tokens(session: ReadSession) -> int:
    return session.scalar(select(func.count()).select_from(Token)) or 0


@router.post("/tokens/early", status_code=201)
def add_early(body: Note, session: WriteSession) -> Note:
    """Holds the writer's place from here until the commit."""
    session.add(Token(name=body.name, role="viewer", hash=body.name))
    session.flush()
    return body


@router.post("/tokens/copies", status_code=201)
def add_copy(body: Note, session: WriteSession) -> dict[str, str]:
    return add_token(body, session)


@router.post("/echo")
async def echo(request: Request) -> int:
    return len(await request.body())


@router.post("/stream", openapi_extra=LARGE_BODY)
async def stream(request: Request) -> int:
    return sum([len(part) async for part in request.stream()])


@router.post("/admin-only", dependencies=[ADMIN])
def admin_only(principal: CurrentPrincipal) -> str:
    return principal.name


@open_router.get("/hello")
def hello() -> str:
    return "hello"
