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


JPEG: Final[dict[int | str, dict[str, Any]]] = {
    200: {"content": {"image/jpeg": {}}, "description": "The picture."}
}
PICTURE: Final[dict[int | str, dict[str, Any]]] = {
    200: {"content": {"image/jpeg": {}, "image/png": {}}, "description": "The picture."}
}
FILE: Final[dict[int | str, dict[str, Any]]] = {
    200: {
        "content": {"application/octet-stream": {}},
        "description": "The file as it was sent.",
    }
}
