"""Files as responses: strong entity tags, conditional requests, single ranges."""

from __future__ import annotations

from typing import Final

from fastapi import Request, Response
from fastapi.responses import FileResponse, StreamingResponse
from starlette.datastructures import Headers

from app.errors import RangeNotSatisfiable
from app.storage.base import StoredBlob

IMMUTABLE: Final = "private, max-age=31536000, immutable"
REVALIDATE: Final = "private, no-cache"
_MAX_DIGITS: Final = 18
_SANDBOX: Final = "default-src 'none'; sandbox"


def known_response(request: Request, digest: str) -> Response | None:
    """A 304 if the client has the file already, else None; no file is opened."""
    headers = blob_headers(digest)
    if not is_known(request, headers["ETag"]):
        return None
    return Response(status_code=304, headers=headers)


def file_response(
    request: Request, blob: StoredBlob, digest: str, media_type: str, name: str = ""
) -> Response:
    """A response with a file, which never changes under its digest."""
    headers = blob_headers(digest)
    if name:
        headers["Content-Disposition"] = f'attachment; filename="{name}"'
    if is_known(request, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    if request.headers.get("if-range", headers["ETag"]) != headers["ETag"]:
        # The client has part of another version: it needs all of this one.
        _without_range(request)
    else:
        _check_range(request, blob.size_bytes)
    if blob.path is not None:
        return FileResponse(blob.path, media_type=media_type, headers=headers)
    return _streamed(request, blob, media_type, headers)


def _streamed(
    request: Request, blob: StoredBlob, media_type: str, headers: dict[str, str]
) -> Response:
    """A response with a blob from a bucket, read a few megabytes at a time."""
    # Not `request.headers`, which are cached: `_without_range` has changed the scope.
    wanted = Headers(scope=request.scope).get("range", "")
    size, span = blob.size_bytes, wanted.partition("=")[2]
    first, end = 0, size
    if span:
        start, _, last = span.strip().partition("-")
        first = int(start) if start else max(0, size - int(last))
        end = min(int(last) + 1, size) if start and last else size
        headers["Content-Range"] = f"bytes {first}-{end - 1}/{size}"
    headers |= {"Accept-Ranges": "bytes", "Content-Length": str(end - first)}
    return StreamingResponse(
        blob.pieces(first, end),
        status_code=206 if span else 200,
        media_type=media_type,
        headers=headers,
    )


def blob_headers(tag: str) -> dict[str, str]:
    """Headers of a blob: its content never changes, and no browser may execute it."""
    return {
        "ETag": f'"{tag}"',
        "Cache-Control": IMMUTABLE,
        "Content-Security-Policy": _SANDBOX,
    }


def is_known(request: Request, etag: str) -> bool:
    """Whether the client has this version already, by its If-None-Match header."""
    known = request.headers.get("if-none-match", "")
    tags = [tag.strip().removeprefix("W/") for tag in known.split(",")]
    return etag in tags or known.strip() == "*"


def _check_range(request: Request, size: int) -> None:
    """Drop a Range header that is not one valid range: HTTP allows ignoring it.

    Raises
    ------
    RangeNotSatisfiable
        The range begins after the end of the file.
    """
    wanted = request.headers.get("range", "")
    unit, _, spans = wanted.partition("=")
    if unit.strip().lower() != "bytes" or "," in spans:
        _without_range(request)
        return
    first, dash, last = spans.strip().partition("-")
    numbers = all(part == "" or _is_offset(part) for part in (first, last))
    if not dash or not numbers or (first == "" and last == ""):
        _without_range(request)
        return
    if last and first and int(last) < int(first):
        _without_range(request)
        return
    empty_suffix = first == "" and int(last) == 0
    if empty_suffix or (first and int(first) >= size):
        raise RangeNotSatisfiable(size_bytes=size)


def _is_offset(text: str) -> bool:
    # `isdecimal` refuses superscripts; int() refuses texts of thousands of digits.
    return text.isdecimal() and len(text) <= _MAX_DIGITS


def _without_range(request: Request) -> None:
    headers = [
        (name, value)
        for name, value in request.scope["headers"]
        if name not in (b"range", b"if-range")
    ]
    request.scope["headers"] = headers


_UNCHANGED: Final[dict[int | str, dict[str, object]]] = {
    304: {"description": "Not modified: the client's copy is up to date."}
}
_PARTS: Final[dict[int | str, dict[str, object]]] = {
    **_UNCHANGED,
    416: {"description": "The range is outside the file."},
}
_FILE_TYPES: Final = (
    "image/png",
    "image/jpeg",
    "application/x-ply",
    "application/x-npy",
)


def _headers(**meanings: str) -> dict[str, object]:
    """Request headers that a route honours, for the OpenAPI document."""
    described = [
        {
            "name": name.replace("_", "-"),
            "in": "header",
            "required": False,
            "description": meaning,
            "schema": {"type": "string"},
        }
        for name, meaning in meanings.items()
    ]
    return {"parameters": described}


def picture_of(*types: str) -> dict[int | str, dict[str, object]]:
    """Responses of a route that draws, for the OpenAPI document."""
    content: dict[str, object] = {name: {} for name in types}
    return {200: {"content": content, "description": "The image."}, **_UNCHANGED}


def file_of(*types: str) -> dict[int | str, dict[str, object]]:
    """Responses of a route that sends a file or a part of it, for OpenAPI."""
    content: dict[str, object] = {name: {} for name in types}
    return {
        200: {"content": content, "description": "The file."},
        206: {"content": content, "description": "The requested range."},
        **_PARTS,
    }


TAGGED: Final = _headers(If_None_Match="Entity tags of the client's copies.")
RESUMABLE: Final = _headers(
    If_None_Match="Entity tags of the client's copies.",
    Range="One range of bytes; a header with several is ignored.",
    If_Range="Entity tag of the version of which the client has a part.",
)
WEBP: Final = picture_of("image/webp")
PICTURE: Final = picture_of("image/webp", "image/png")
FILE: Final = file_of(*_FILE_TYPES)
