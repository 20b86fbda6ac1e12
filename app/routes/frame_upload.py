"""A frame as multipart/form-data: parts by name, bounded, kept in memory."""

from __future__ import annotations

from typing import Annotated, Any, Final

from fastapi import Depends, Request
from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser

from app.deps import settings_of
from app.errors import BadRequest, TooLarge, Unprocessable, UnsupportedMedia
from app.services.frame_files import KINDS
from app.settings import Settings

ANNOTATION: Final = "annotation"
_MEDIA_TYPE: Final = "multipart/form-data"


class _InMemoryParser(MultiPartParser):
    """Files of a usual size never touch a temporary file on their way in."""

    spool_max_size = 16 * 1024 * 1024


async def frame_parts(request: Request) -> dict[str, bytes]:
    """The parts of an upload by name; always with an annotation."""
    media_type = request.headers.get("content-type", "")
    if media_type.partition(";")[0].strip().lower() != _MEDIA_TYPE:
        raise UnsupportedMedia(
            f"the body must be {_MEDIA_TYPE}, it says {media_type or 'nothing'!r}"
        )
    settings = settings_of(request)
    form = await _parse(request, settings)
    parts: dict[str, bytes] = {}
    for name, value in form:
        if name not in (ANNOTATION, *KINDS):
            raise Unprocessable(
                f"unknown part {name!r}; expected {ANNOTATION}, {', '.join(KINDS)}",
                code="unknown_part",
            )
        if name in parts:
            raise Unprocessable(f"part {name!r} was sent twice", code="repeated_part")
        parts[name] = await _content(name, value, settings)
    if ANNOTATION not in parts:
        raise Unprocessable(
            f"expected a part {ANNOTATION!r} with the frame's JSON, found "
            f"{', '.join(parts) or 'no part'}",
            code="missing_annotation",
        )
    return parts


async def _parse(
    request: Request, settings: Settings
) -> list[tuple[str, UploadFile | str]]:
    parser = _InMemoryParser(
        request.headers,
        request.stream(),
        max_files=settings.max_parts,
        max_fields=settings.max_parts,
        max_part_size=settings.max_part_bytes,
    )
    try:
        return (await parser.parse()).multi_items()
    except (MultiPartException, KeyError) as error:
        text = getattr(error, "message", "it has no boundary")
        if "maximum size" in text:
            raise TooLarge(
                f"a part is larger than {settings.max_part_bytes} bytes"
            ) from error
        raise BadRequest(
            f"the multipart body cannot be read: {text}", code="bad_multipart"
        ) from error


async def _content(name: str, value: UploadFile | str, settings: Settings) -> bytes:
    content = value.encode() if isinstance(value, str) else await value.read()
    if len(content) > settings.max_part_bytes:
        raise TooLarge(
            f"part {name!r} has {len(content)} bytes, "
            f"expected at most {settings.max_part_bytes}"
        )
    return content


FrameParts = Annotated[dict[str, bytes], Depends(frame_parts)]


def described_body() -> dict[str, Any]:
    """The body for the OpenAPI document: FastAPI cannot see into a dependency."""
    binary = {"type": "string", "format": "binary"}
    properties: dict[str, Any] = dict.fromkeys(KINDS, binary)
    properties[ANNOTATION] = {
        "type": "string",
        "contentMediaType": "application/json",
        "description": "Boxes, camera and more; see the guide to formats.",
    }
    schema = {"type": "object", "properties": properties, "required": [ANNOTATION]}
    return {
        "requestBody": {"required": True, "content": {_MEDIA_TYPE: {"schema": schema}}}
    }
