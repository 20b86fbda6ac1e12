"""Pictures and files as the OpenAPI document describes their answers."""

from __future__ import annotations

from typing import Any, Final

_UNCHANGED: Final[dict[int | str, dict[str, Any]]] = {
    304: {"description": "What you have is still it."}
}
_PARTS: Final[dict[int | str, dict[str, Any]]] = {
    **_UNCHANGED,
    416: {"description": "There is no such part of the file."},
}
_FILE_TYPES: Final = (
    "image/png",
    "image/jpeg",
    "application/x-ply",
    "application/x-npy",
)


def _headers(**meanings: str) -> dict[str, Any]:
    """Headers that a route honours, for the OpenAPI document."""
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


def picture_of(*types: str) -> dict[int | str, dict[str, Any]]:
    """Answers of a route that draws."""
    content: dict[str, Any] = {name: {} for name in types}
    return {200: {"content": content, "description": "The picture."}, **_UNCHANGED}


def file_of(*types: str) -> dict[int | str, dict[str, Any]]:
    """Answers of a route that sends a file, or one part of it."""
    content: dict[str, Any] = {name: {} for name in types}
    return {
        200: {"content": content, "description": "The file."},
        206: {"content": content, "description": "The part that was asked for."},
        **_PARTS,
    }


TAGGED: Final = _headers(If_None_Match="Entity tags of what you have.")
RESUMABLE: Final = _headers(
    If_None_Match="Entity tags of what you have.",
    Range="One range of bytes; several are taken as none.",
    If_Range="Entity tag of the file that the range is of.",
)
JPEG: Final = picture_of("image/jpeg")
PICTURE: Final = picture_of("image/jpeg", "image/png")
FILE: Final = file_of(*_FILE_TYPES)
