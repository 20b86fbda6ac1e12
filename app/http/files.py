"""Files as responses: strong entity tags, conditional requests, single ranges."""

from __future__ import annotations

import re
from typing import Final

from fastapi import Request, Response
from fastapi.responses import FileResponse, StreamingResponse

from app.errors import RangeNotSatisfiable
from app.storage.base import StoredBlob

IMMUTABLE: Final = "private, max-age=31536000, immutable"
REVALIDATE: Final = "private, no-cache"
_RANGE: Final = re.compile(
    r"\s*bytes\s*=\s*([0-9]{0,18})-([0-9]{0,18})\s*", re.IGNORECASE
)


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
    span = _requested_range(request, headers["ETag"], blob.size_bytes)
    if blob.path is not None:
        return FileResponse(blob.path, media_type=media_type, headers=headers)
    # A blob from a bucket, read a few megabytes at a time.
    start, end = span or (0, blob.size_bytes)
    if span:
        headers["Content-Range"] = f"bytes {start}-{end - 1}/{blob.size_bytes}"
    headers |= {"Accept-Ranges": "bytes", "Content-Length": str(end - start)}
    return StreamingResponse(
        blob.pieces(start, end),
        status_code=206 if span else 200,
        media_type=media_type,
        headers=headers,
    )


def _requested_range(request: Request, etag: str, size: int) -> tuple[int, int] | None:
    """Start and end of the range that is asked for; None: the whole file.

    A header that is not one valid range is removed, so that FileResponse does not read
    it: HTTP allows ignoring it.
    """
    span = _RANGE.fullmatch(request.headers.get("range", ""))
    first, last = span.groups() if span else ("", "")
    # The client may have part of another version: it needs all of this one then.
    is_same = request.headers.get("if-range", etag) == etag
    is_reversed = bool(first and last) and int(last) < int(first)
    if not is_same or is_reversed or first == last == "":
        ignored = (b"range", b"if-range")
        every = request.scope["headers"]
        request.scope["headers"] = [pair for pair in every if pair[0] not in ignored]
        return None
    if (int(first) >= size) if first else (int(last) == 0):
        raise RangeNotSatisfiable(size_bytes=size)
    if first:
        return int(first), min(int(last) + 1, size) if last else size
    return max(0, size - int(last)), size


def blob_headers(tag: str) -> dict[str, str]:
    """Headers of a blob: its content never changes, and no browser may execute it."""
    return {
        "ETag": f'"{tag}"',
        "Cache-Control": IMMUTABLE,
        "Content-Security-Policy": "default-src 'none'; sandbox",
    }


def is_known(request: Request, etag: str) -> bool:
    """Whether the client has this version already, by its If-None-Match header."""
    header = request.headers.get("if-none-match", "")
    tags = [tag.strip().removeprefix("W/") for tag in header.split(",")]
    return etag in tags or header.strip() == "*"


_UNCHANGED: Final[dict[int | str, dict[str, object]]] = {
    304: {"description": "Not modified: the client's copy is up to date."}
}


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
    return {200: {"content": content, "description": "What is drawn."}, **_UNCHANGED}


def file_of(*types: str) -> dict[int | str, dict[str, object]]:
    """Responses of a route that sends a file or a part of it, for OpenAPI."""
    content: dict[str, object] = {name: {} for name in types}
    return {
        200: {"content": content, "description": "The file."},
        206: {"content": content, "description": "The requested range."},
        **_UNCHANGED,
        416: {"description": "The range is outside the file."},
    }


TAGGED: Final = _headers(If_None_Match="Entity tags of the client's copies.")
RESUMABLE: Final = _headers(
    If_None_Match="Entity tags of the client's copies.",
    Range="One range of bytes; a header with several is ignored.",
    If_Range="Entity tag of the version of which the client has a part.",
)
WEBP: Final = picture_of("image/webp")
PICTURE: Final = picture_of("image/webp", "image/png")
FILE: Final = file_of(
    "image/png", "image/jpeg", "application/x-ply", "application/x-npy"
)
