"""The review page's shell and files, and the machine's description of the API."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from app.docs_page import docs_page, docs_style
from app.page_files import PageFile, page_file, shell_page
from app.resources import static_dir
from app.routing import ApiRouter, OpenRouter

shell = APIRouter(redirect_slashes=False)
files = OpenRouter()
description = ApiRouter()


@shell.get("/", include_in_schema=False)
async def index(request: Request) -> Response:
    """The page. Its filters live in the URL, so any query parameter is allowed."""
    return _answer(request, shell_page(static_dir()))


@files.get("/static/{name:path}", include_in_schema=False)
async def static_file(name: str, request: Request) -> Response:
    """One file of the page. Small and kept in memory: not worth a thread each."""
    return _answer(request, page_file(static_dir(), name))


@description.get("/openapi.json", include_in_schema=False)
async def openapi(request: Request) -> dict[str, Any]:
    """The API, for machines."""
    schema: dict[str, Any] = request.app.openapi()
    return schema


@description.get("/docs", include_in_schema=False)
async def docs(request: Request) -> Response:
    """The API, for people."""
    page = docs_page(request.app.openapi())
    return Response(page, media_type="text/html; charset=utf-8")


@description.get("/docs/style.css", include_in_schema=False)
async def docs_css() -> Response:
    """How the description looks."""
    return Response(docs_style(), media_type="text/css; charset=utf-8")


def _answer(request: Request, file: PageFile) -> Response:
    headers = {"ETag": file.etag, "Cache-Control": "no-cache"}
    known = request.headers.get("if-none-match", "")
    if file.etag in (tag.strip().removeprefix("W/") for tag in known.split(",")):
        return Response(status_code=304, headers=headers)
    return Response(file.content, headers=headers, media_type=file.media_type)


router = APIRouter(redirect_slashes=False)
for part in (shell, files, description):
    router.include_router(part)
