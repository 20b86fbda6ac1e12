"""Files as answers: strong entity tags, conditional requests, single ranges."""

from __future__ import annotations

import asyncio
import threading
from typing import Final

from anyio import CapacityLimiter, to_thread
from fastapi import Request, Response
from fastapi.responses import FileResponse, StreamingResponse
from starlette.datastructures import Headers

from app.context import ServiceContext
from app.engine.pixels import GivenUp, PixelsRefused
from app.errors import RangeNotSatisfiable
from app.http.bodies import stopping
from app.http.routing import (
    CLIENT_LEFT,
    TokenPlaces,
    asks_for_head,
    has_left,
    without_length,
)
from app.services.pictures import Drawing, DrawnPictures
from app.storage import Blob

IMMUTABLE: Final = "private, max-age=31536000, immutable"
REVALIDATE: Final = "private, no-cache"
_MAX_DIGITS: Final = 18
_SANDBOX: Final = "default-src 'none'; sandbox"


def known_response(request: Request, digest: str) -> Response | None:
    """The answer to whoever has a file already: it is not even looked at."""
    headers = blob_headers(digest)
    if not _is_known(request, headers["ETag"]):
        return None
    return Response(status_code=304, headers=headers)


def file_response(
    request: Request, blob: Blob, digest: str, media_type: str, name: str = ""
) -> Response:
    """A file that never changes under its digest."""
    headers = blob_headers(digest)
    if name:
        headers["Content-Disposition"] = f'attachment; filename="{name}"'
    if _is_known(request, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    if request.headers.get("if-range", headers["ETag"]) != headers["ETag"]:
        # What there is at the other end is a part of another file.
        _without_range(request)
    else:
        _check_range(request, blob.size_bytes)
    if blob.path is not None:
        return FileResponse(blob.path, media_type=media_type, headers=headers)
    return _streamed(request, blob, media_type, headers)


def _streamed(
    request: Request, blob: Blob, media_type: str, headers: dict[str, str]
) -> Response:
    """A blob from elsewhere, as a file would be answered; some of it at a time."""
    # Read anew: a range that is not to be answered was taken out of them.
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


async def drawn_response(
    request: Request, services: ServiceContext, drawing: Drawing
) -> Response:
    """A picture, drawn unless the browser has it or it was drawn lately.

    As many are drawn at the same time as there are processes for it, and one fewer for
    one token; the others wait without a thread. A client that leaves ends the drawing
    of its picture, and so does a stop of the service: it can be asked for again.
    """
    headers = blob_headers(drawing.tag) | {"Cache-Control": REVALIDATE}
    if _is_known(request, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    if asks_for_head(request):  # its length alone is not worth drawing it
        return without_length(Response(media_type=drawing.media_type, headers=headers))
    content = services.one(DrawnPictures).find(drawing.tag)
    if content is None:
        content = await _drawn(request, services, drawing)
    if content is None:
        return Response(status_code=CLIENT_LEFT)
    services.one(DrawnPictures).keep(drawing.tag, content)
    return Response(content, media_type=drawing.media_type, headers=headers)


async def _drawn(
    request: Request, services: ServiceContext, drawing: Drawing
) -> bytes | None:
    """The picture itself; None if nobody waits for it any more.

    Raises
    ------
    NotReady
        The service stops.
    """
    given_up = threading.Event()
    drawn = asyncio.ensure_future(_draw(request, services, drawing, given_up))
    left = asyncio.ensure_future(has_left(request))
    stop = services.engine.stopping
    try:
        with stop.telling(given_up.set):
            if stop.is_set():
                raise stopping()
            await asyncio.wait({drawn, left}, return_when=asyncio.FIRST_COMPLETED)
            return drawn.result() if drawn.done() else None
    except GivenUp:
        raise stopping() from None
    except PixelsRefused as refused:
        services.one(DrawnPictures).refuse(drawing.tag, refused)
        raise
    finally:
        given_up.set()
        drawn.cancel()
        left.cancel()
        await asyncio.wait({drawn, left})


async def _draw(
    request: Request,
    services: ServiceContext,
    drawing: Drawing,
    given_up: threading.Event,
) -> bytes:
    of_token: TokenPlaces = request.app.state.drawing
    places: CapacityLimiter = request.app.state.drawings
    async with of_token.of(request.state.principal.token_id):
        return await to_thread.run_sync(
            drawing.draw, services.drawers, given_up, limiter=places
        )


def blob_headers(tag: str) -> dict[str, str]:
    """A blob is data: whatever it claims to be, no browser may run it."""
    return {
        "ETag": f'"{tag}"',
        "Cache-Control": IMMUTABLE,
        "Content-Security-Policy": _SANDBOX,
    }


def _is_known(request: Request, etag: str) -> bool:
    known = request.headers.get("if-none-match", "")
    tags = [tag.strip().removeprefix("W/") for tag in known.split(",")]
    return etag in tags or known.strip() == "*"


def _check_range(request: Request, size: int) -> None:
    """Leave single ranges to the answer; take several as none, as HTTP allows."""
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
    # Superscripts are digits as well, and int() refuses thousands of them.
    return text.isdecimal() and len(text) <= _MAX_DIGITS


def _without_range(request: Request) -> None:
    headers = [
        (name, value)
        for name, value in request.scope["headers"]
        if name not in (b"range", b"if-range")
    ]
    request.scope["headers"] = headers
