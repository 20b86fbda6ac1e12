"""Pictures that are drawn on request: what can be asked for."""

from __future__ import annotations

from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

Layer = Literal["image", "segmentation", "blend"]


class CropQuery(BaseModel):
    """How to cut a box out of its frame."""

    model_config = ConfigDict(extra="forbid")

    layer: Layer = "image"
    pad: float = Field(
        default=0.25,
        ge=0,
        le=10,
        allow_inf_nan=False,
        description="Added on every side, in parts of the box's longer side.",
    )
    height: int = Field(default=256, ge=16, le=2048, description="Most pixels high.")


class OverlayQuery(BaseModel):
    """What to draw over a frame."""

    model_config = ConfigDict(extra="forbid")

    layer: Layer = "image"
    boxes: str = Field(
        default="kept,rejected,unmeasured",
        pattern=r"^((kept|rejected|unmeasured)(,(kept|rejected|unmeasured))*)?$",
        description="Effective verdicts whose boxes are drawn; empty for none.",
    )
    edges: Literal["2d", "3d"] = "2d"

    def verdicts(self) -> frozenset[str]:
        """The verdicts whose boxes are drawn."""
        return frozenset(self.boxes.split(",")) - {""}


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
