"""Datasets as they are sent."""

from __future__ import annotations

from base64 import b64decode
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from filter_core.images.header import read_image_header
from filter_core.segmentation.reading import PALETTES, Encoding, Lossy, OrderOfChannels

NAME_PATTERN = r"^[a-z0-9](?:[a-z0-9._-]{0,98}[a-z0-9])?$"

if TYPE_CHECKING:
    _Palette: TypeAlias = str
else:
    # Its values are known when the library has been loaded, not to a type checker.
    _Palette = Literal[PALETTES]
ClassName = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
Description = Annotated[str, Field(max_length=2000, pattern=r"^[^\x00]*$")]
Pixel = Annotated[float, Field(allow_inf_nan=False)]
Point = Annotated[list[Pixel], Field(min_length=2, max_length=2)]
Polygon = Annotated[list[Point], Field(min_length=3, max_length=1000, fail_fast=True)]
Polygons = Annotated[list[Polygon], Field(min_length=1, max_length=100, fail_fast=True)]


class IgnoreMask(BaseModel):
    """Where pixels never count, for instance on the ego's bonnet: one of two forms."""

    model_config = ConfigDict(extra="forbid")

    polygons: Polygons | None = Field(default=None, description="Corners in pixels.")
    png: Annotated[str, Field(max_length=2_000_000)] | None = Field(
        default=None,
        description="A PNG of the frames' size, in Base64; not black is ignored.",
    )

    @field_validator("png")
    @classmethod
    def _is_a_picture(cls, value: str | None) -> str | None:
        if value is not None:
            read_image_header(b64decode(value, validate=True))
        return value

    @model_validator(mode="after")
    def _has_one_form(self) -> IgnoreMask:
        if (self.polygons is None) == (self.png is None):
            raise ValueError("expected either polygons or png")
        return self

    def stored(self) -> dict[str, Any]:
        """The form that was given."""
        return self.model_dump(exclude_none=True)


class DatasetIn(BaseModel):
    """A new dataset."""

    model_config = ConfigDict(extra="forbid")

    name: Annotated[
        str,
        Field(
            pattern=NAME_PATTERN,
            description="Lower-case letters, digits, dots, dashes, underscores.",
        ),
    ]
    description: Description = ""
    classes: Annotated[list[ClassName], Field(max_length=1000)] | None = Field(
        default=None, description="Ordered; unset: the eight classes of CARLA."
    )
    palette: _Palette = "auto"
    encoding: Encoding = "auto"
    channel_order: OrderOfChannels = "auto"
    lossy_segmentation: Lossy = "refuse"
    ignore_mask: IgnoreMask | None = None


def _without_null(schema: dict[str, Any]) -> None:
    """Say what the validator asks for: null is no value of anything but a mask."""
    for name, value in schema["properties"].items():
        if name != "ignore_mask":
            (value_schema,) = (
                one for one in value.pop("anyOf") if one != {"type": "null"}
            )
            value.update(value_schema)
            value.pop("default", None)


class DatasetPatch(BaseModel):
    """What to change; how segmentations are read starts a run that measures again."""

    model_config = ConfigDict(extra="forbid", json_schema_extra=_without_null)

    description: Description | None = None
    palette: _Palette | None = None
    encoding: Encoding | None = None
    channel_order: OrderOfChannels | None = None
    lossy_segmentation: Lossy | None = None
    ignore_mask: IgnoreMask | None = Field(default=None, description="null: none.")

    @field_validator("*", mode="before")
    @classmethod
    def _only_a_mask_can_be_taken_away(cls, value: Any, field: ValidationInfo) -> Any:  # noqa: ANN401  # any JSON value
        if value is None and field.field_name != "ignore_mask":
            raise ValueError("expected a value, found null; leave the key out instead")
        return value
