"""Configurations, previews, runs and exports as they are sent and answered."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeAlias

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from app.schemas.datasets import ClassCounts
from filter_core.formats.export import (
    MAX_BAND,
    MAX_BANDS,
    Boxes,
    Images,
    Include,
    Rejected,
)
from filter_core.formats.registry import EXPORT_FORMATS

if TYPE_CHECKING:
    _FormatName: TypeAlias = str
else:
    # Its values are known when the library has been loaded, not to a type checker.
    _FormatName = Literal[EXPORT_FORMATS]

Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


def _in_either_form(value: object, check: ValidatorFunctionWrapHandler) -> object:
    """One fault instead of one for each form that it does not have."""
    try:
        return check(value)
    except ValidationError as exc:
        raise ValueError(_EITHER_FORM) from exc


_EITHER_FORM: Final = (
    "expected a configuration, or a digest of 64 hexadecimal digits of one"
)
State = Literal["queued", "running", "done", "failed", "cancelled"]


class ConfigOut(BaseModel):
    """One immutable version of a dataset's filter configuration."""

    digest: str
    config: dict[str, Any]
    unused_keys: list[str]
    created_by: str
    created_at: datetime
    active: bool


class ActivateIn(BaseModel):
    """Which version becomes active."""

    model_config = ConfigDict(extra="forbid")

    digest: Digest


class PreviewIn(BaseModel):
    """A configuration to try; nothing is written."""

    model_config = ConfigDict(extra="forbid")

    config: dict[str, Any]
    limit: Annotated[
        int, Field(ge=0, le=1000, description="Most flips that are listed.")
    ] = 100
    bins: Annotated[int, Field(ge=2, le=200)] = 50


class Outcome(BaseModel):
    """A verdict and its reason."""

    verdict: str
    reason: str


class FlipOut(BaseModel):
    """A box that would be decided otherwise."""

    model_config = ConfigDict(populate_by_name=True)

    box_id: int
    frame_id: int
    class_name: str = Field(alias="class")
    match_percent: float | None
    before: Outcome
    after: Outcome


class FlipCounts(BaseModel):
    """How many boxes change sides, by the side they leave."""

    kept_to_rejected: int
    rejected_to_kept: int


class FlipsOut(FlipCounts):
    """What would change."""

    total: int
    by_class: dict[str, FlipCounts]
    items: list[FlipOut]


class PreviewOut(BaseModel):
    """What a configuration would decide."""

    config: str
    needs_pixels: bool
    counts: ClassCounts | None
    by_reason: dict[str, int] | None
    by_class: dict[str, ClassCounts] | None
    reasons_by_class: dict[str, dict[str, int]] | None
    histograms: dict[str, Any] | None
    flips: FlipsOut | None


class DiffOut(BaseModel):
    """What one run decides otherwise than another, one page of it."""

    run: int
    against: int
    compared: int = Field(description="Boxes that both runs have numbers of.")
    total: int = Field(description="Those whose verdicts differ.")
    kept_to_rejected: int
    rejected_to_kept: int
    by_class: dict[str, int] = Field(description="Boxes whose verdicts differ.")
    sides_by_class: dict[str, FlipCounts] = Field(
        description="Of those, the ones that went from one side to the other."
    )
    items: list[FlipOut]
    next_cursor: str | None = None


class RunIn(BaseModel):
    """Apply a configuration: by digest, or written out."""

    model_config = ConfigDict(extra="forbid")

    config: Annotated[Digest | dict[str, Any], WrapValidator(_in_either_form)]
    scope: Literal["dataset"] = "dataset"
    activate: bool = False


class RunOut(BaseModel):
    """One configuration applied to a dataset."""

    id: int
    dataset: str
    kind: Literal["decide", "measure"]
    state: State
    config: str
    activate: bool
    total: int
    done: int
    changed: int
    counts: dict[str, int]
    error: dict[str, Any] | None
    created_by: str
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


class ExportOptions(BaseModel):
    """What goes into an export."""

    model_config = ConfigDict(extra="forbid")

    include: Annotated[
        Include, Field(description="By the effective verdict, the filter's, or all.")
    ] = "effective"
    include_unmeasured: Annotated[
        bool, Field(description="Also boxes that nothing could be measured of.")
    ] = False
    rejected: Annotated[
        Rejected, Field(description="Leave rejected boxes out, or have them ignored.")
    ] = "drop"
    boxes: Annotated[
        Boxes, Field(description="Which rectangle, where a box has several.")
    ] = "visible"
    images: Annotated[Images, Field(description="Put the images in, or not.")] = "copy"
    split: Annotated[
        float, Field(ge=0, le=1, description="Share of the frames for training.")
    ] = 0.8
    bands: Annotated[
        list[Annotated[int, Field(ge=1, le=MAX_BAND)]],
        Field(
            max_length=MAX_BANDS,
            description="Labels once more for each distance (metres), with the boxes "
            "up to it.",
        ),
    ] = []


class ExportIn(BaseModel):
    """Labels to write."""

    model_config = ConfigDict(extra="forbid")

    format: Annotated[
        _FormatName,
        Field(description="One of the formats of docs/formats.md."),
    ]
    options: ExportOptions = ExportOptions()


class ExportOut(BaseModel):
    """Labels written, or being written."""

    id: int
    dataset: str
    format: str
    options: dict[str, Any]
    state: State
    total: int = Field(description="Frames.")
    done: int
    size_bytes: int | None
    sha256: str | None
    counts: dict[str, Any] | None
    error: dict[str, Any] | None
    created_at: datetime
    download: str | None
