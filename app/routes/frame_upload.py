"""A frame as multipart/form-data: parts by name, bounded, kept in memory."""

from __future__ import annotations

from typing import Annotated, Any, Final

from fastapi import Depends, Request

from app.errors import Unprocessable, UnsupportedMedia
from app.http.bodies import PartLimits, read_parts
from app.http.deps import services_of, settings_of
from app.http.routing import body_up_to
from app.services.frame_files import KINDS
from app.storage.room import require_room

ANNOTATION: Final = "annotation"
_MEDIA_TYPE: Final = "multipart/form-data"


async def frame_parts(request: Request) -> dict[str, bytes]:
    """The parts of an upload by name; always with an annotation."""
    media_type = request.headers.get("content-type", "")
    if media_type.partition(";")[0].strip().lower() != _MEDIA_TYPE:
        raise UnsupportedMedia(
            f"the body must be {_MEDIA_TYPE}, it says {media_type or 'nothing'!r}"
        )
    settings = settings_of(request)
    require_room(settings, services_of(request).storage)
    limits = PartLimits(settings.max_parts, settings.max_part_bytes)
    parts: dict[str, bytes] = {}
    for part in await read_parts(media_type, request.stream(), limits):
        if part.name not in (ANNOTATION, *KINDS):
            raise Unprocessable(
                f"unknown part {part.name!r}; "
                f"expected {ANNOTATION}, {', '.join(KINDS)}",
                code="unknown_part",
            )
        if part.name in parts:
            raise Unprocessable(
                f"part {part.name!r} was sent twice", code="repeated_part"
            )
        parts[part.name] = part.content
    if ANNOTATION not in parts:
        raise Unprocessable(
            f"expected a part {ANNOTATION!r} with the frame's JSON, found "
            f"{', '.join(parts) or 'no part'}",
            code="missing_annotation",
        )
    return parts


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
    content = {_MEDIA_TYPE: {"schema": schema}}
    body = {"requestBody": {"required": True, "content": content}}
    return {**body, **body_up_to("max_body_bytes")}
