"""The review page's shell and files, and the machine's description of the API."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from app.docs_page import docs_page
from app.head_requests import HeadRoute
from app.page_files import PageFile, page_file, shell_page
from app.resources import static_dir
from app.routing import ApiRouter, OpenRouter
from app.security import FORMER_COOKIE

shell = APIRouter(redirect_slashes=False, route_class=HeadRoute)
files = OpenRouter()
description = ApiRouter()


@shell.get("/", include_in_schema=False)
async def index(request: Request) -> Response:
    """The page. Its filters live in the URL, so any query parameter is allowed."""
    answer = _answer(request, shell_page(static_dir()))
    if FORMER_COOKIE in request.cookies:
        answer.delete_cookie(FORMER_COOKIE, httponly=True, samesite="strict")
    return answer


@files.get("/static/{name:path}", include_in_schema=False)
async def static_file(name: str, request: Request) -> Response:
    """One file of the page. Small and kept in memory: not worth a thread each."""
    return _answer(request, page_file(static_dir(), name))


@description.get("/openapi.json", include_in_schema=False)
async def openapi(request: Request) -> dict[str, Any]:
    """The API, for machines."""
    schema: dict[str, Any] = request.app.openapi()
    return schema


@files.get("/docs", include_in_schema=False)
async def docs(request: Request) -> Response:
    """The page that shows `/docs/content` to whoever is signed in."""
    return _answer(request, page_file(static_dir(), "docs.html"))


@description.get("/docs/content", include_in_schema=False)
async def docs_content(request: Request) -> Response:
    """The API, for people."""
    page = docs_page(request.app.openapi())
    return Response(page, media_type="text/html; charset=utf-8")


def _answer(request: Request, file: PageFile) -> Response:
    headers = {"ETag": file.etag, "Cache-Control": "no-cache"}
    known = request.headers.get("if-none-match", "")
    if file.etag in (tag.strip().removeprefix("W/") for tag in known.split(",")):
        return Response(status_code=304, headers=headers)
    return Response(file.content, headers=headers, media_type=file.media_type)


router = APIRouter(redirect_slashes=False)
for part in (shell, files, description):
    router.include_router(part)
