"""The page's shell and files: media types, caching, and Content-Security-Policy.

The shell refers to all files of the page by URLs with a version, which changes with any
of them: `/static/v-9f86d081884c7d65/js/main.js`. Modules import each other by relative
URLs, which include the version. A browser may cache such a file forever and revalidates
only the shell. Files at a URL without a version are revalidated each time. The style
sheets that the shell names are served as one file, and the modules as two scripts
(`packs`), which saves a hundred requests. Each module has its own URL as well.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from fastapi import APIRouter, FastAPI, Request, Response

from app.errors import NotFound
from app.http.files import IMMUTABLE, is_known
from app.http.openapi import docs_page
from app.http.packs import ENTRY, FIRST, LATER, packs_of
from app.http.routing import HeadRoute, OpenRouter
from app.package import static_dir

# Not from the system's table: on Windows it may define JavaScript as plain text.
MEDIA_TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".ico": "image/x-icon",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".mjs": "text/javascript; charset=utf-8",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
    ".webmanifest": "application/manifest+json",
    ".woff2": "font/woff2",
}
_INLINE_MAP: Final = re.compile(
    rb"<script[^>]*\btype=[\"']importmap[\"'][^>]*>(.*?)</script>", re.DOTALL
)
_STYLE_LINK: Final = re.compile(rb'<link rel="stylesheet" href="/static/([^"]+)" />\s*')
STYLES: Final = "styles.css"
"""The name of all style sheets of the page, one after the other; it is no file."""
_VERSION: Final = re.compile(r"v-([0-9a-f]{16})/")


@dataclass(frozen=True)
class PageFile:
    """One file of the page."""

    content: bytes
    media_type: str
    etag: str

    @classmethod
    def of(cls, content: bytes, suffix: str) -> PageFile:
        """With the media type of this suffix, and a hash of the content as its tag."""
        digest = hashlib.sha256(content).hexdigest()
        return cls(content, MEDIA_TYPES[suffix], f'"{digest[:32]}"')


def page_file(folder: Path, name: str) -> PageFile:
    """A file below the folder, all style sheets of the page (`STYLES`), or a pack.

    Raises NotFound: there is no such file, its type is unknown, or it is outside of the
    folder.
    """
    if name == STYLES:
        names = _STYLE_LINK.findall(page_file(folder, "index.html").content)
        sheets = [(link, page_file(folder, link.decode()).content) for link in names]
        return PageFile.of(
            b"".join(b"/* %b */\n%b\n" % pair for pair in sheets), ".css"
        )
    if name in (FIRST, LATER) and (folder / ENTRY).is_file():
        return _packs(folder, page_version(folder))[name]
    try:
        path = (folder / name).resolve()
        is_there = path.is_relative_to(folder.resolve()) and path.is_file()
        changed = path.stat().st_mtime_ns if is_there else 0
    except (OSError, ValueError):  # a NUL, or a name that is too long
        is_there = False
    if not is_there or path.suffix not in MEDIA_TYPES:
        raise NotFound("file", name)
    return _read(path, changed)


def version_of(folder: Path) -> str:
    """A hash of all files in the folder, the same on every server."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix in MEDIA_TYPES:
            etag = _read(path, path.stat().st_mtime_ns).etag
            digest.update(f"{path.relative_to(folder).as_posix()} {etag}\n".encode())
    return digest.hexdigest()[:16]


def page_version(folder: Path) -> str:
    """`version_of`, cached for a second: a developer may be changing the page."""
    return _version_at(folder, int(time.monotonic()))


@lru_cache(maxsize=4)
def _version_at(folder: Path, _second: int) -> str:
    return version_of(folder)


@lru_cache(maxsize=4)
def shell_page(folder: Path, version: str) -> PageFile:
    """The page with one style sheet and one script in place of its files."""
    page = page_file(folder, "index.html").content
    before, *others = _STYLE_LINK.split(page)[::2]  # between them are the names
    link = f'<link rel="stylesheet" href="/static/{STYLES}" />\n    '.encode()
    content = before + link + b"".join(others)
    for old, new in ((ENTRY, FIRST), ("", f"v-{version}/")):
        content = content.replace(
            f'"/static/{old}'.encode(), f'"/static/{new}'.encode()
        )
    return PageFile.of(content, ".html")


@lru_cache(maxsize=4)
def _packs(folder: Path, _version: str) -> dict[str, PageFile]:
    packs = packs_of(folder).items()
    return {name: PageFile.of(text, ".js") for name, text in packs}


@lru_cache(maxsize=512)
def _read(path: Path, _changed: int) -> PageFile:
    content = path.read_bytes()
    return PageFile.of(content, path.suffix)


def content_security_policy(index: Path) -> str:
    """The Content-Security-Policy: own files only, and the page's import map.

    Trusted Types forbid turning text into elements or code. An API-only installation
    has no page and so no import map.
    """
    page = index.read_bytes() if index.is_file() else b""
    maps = (hashlib.sha256(text).digest() for text in _INLINE_MAP.findall(page))
    hashes = "".join(f" 'sha256-{base64.b64encode(d).decode()}'" for d in maps)
    return (
        "default-src 'none'; "
        f"script-src 'self'{hashes}; "
        "style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'none'; "
        "require-trusted-types-for 'script'; trusted-types 'none'"
    )


router = APIRouter(redirect_slashes=False, route_class=HeadRoute)
files_router = OpenRouter()
description_router = OpenRouter()


@router.get("/", include_in_schema=False)
async def index(request: Request) -> Response:
    """The page. Its filters are in the URL, so any query parameter is allowed.

    Its pictures will be drawn soon, which a process is started for meanwhile.
    """
    request.app.state.services.drawers.prepare()
    folder = static_dir()
    return _file_response(request, shell_page(folder, page_version(folder)))


@files_router.get("/static/{name:path}", include_in_schema=False)
async def static_file(name: str, request: Request) -> Response:
    """One file of the page, from memory, and so not in a thread.

    A page that was opened before an update requests URLs of the former version. It gets
    the current file, without permission to cache it.
    """
    folder, version = static_dir(), _VERSION.match(name)
    file = page_file(folder, name[version.end() :] if version else name)
    is_current = version is not None and version[1] == page_version(folder)
    return _file_response(request, file, IMMUTABLE if is_current else "no-cache")


@description_router.get("/openapi.json", include_in_schema=False)
def openapi(request: Request) -> Response:
    """The OpenAPI document; in a thread, since generating it the first time is slow."""
    return _file_response(request, _description(request.app)[0])


@description_router.get("/docs", include_in_schema=False)
def docs(request: Request) -> Response:
    """The API as HTML; in a thread, as `openapi`."""
    return _file_response(request, _description(request.app)[1])


@lru_cache(maxsize=1)
def _description(app: FastAPI) -> tuple[PageFile, PageFile]:
    """The OpenAPI document and the page of it, kept, since anybody may ask for them."""
    document = app.openapi()
    text = json.dumps(document, ensure_ascii=False)
    page = docs_page(document)
    return PageFile.of(text.encode(), ".json"), PageFile.of(page.encode(), ".html")


def _file_response(
    request: Request, file: PageFile, cached: str = "no-cache"
) -> Response:
    headers = {"ETag": file.etag, "Cache-Control": cached}
    if is_known(request, file.etag):
        return Response(status_code=304, headers=headers)
    return Response(file.content, headers=headers, media_type=file.media_type)
