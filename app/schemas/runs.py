"""Configurations, previews, runs and exports as they are sent and answered."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.schemas.datasets import ClassCounts

Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


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


class FlipsOut(BaseModel):
    """What would change."""

    total: int
    kept_to_rejected: int
    rejected_to_kept: int
    items: list[FlipOut]


class PreviewOut(BaseModel):
    """What a configuration would decide."""

    config: str
    needs_pixels: bool
    counts: ClassCounts | None
    by_reason: dict[str, int] | None
    by_class: dict[str, ClassCounts] | None
    histograms: dict[str, Any] | None
    flips: FlipsOut | None


class RunIn(BaseModel):
    """Apply a configuration: by digest, or written out."""

    model_config = ConfigDict(extra="forbid")

    config: Digest | dict[str, Any]
    scope: Literal["dataset"] = "dataset"
    activate: bool = False


class RunOut(BaseModel):
    """One configuration applied to a dataset."""

    id: int
    dataset: str
    kind: str
    state: str
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

    include: Literal["effective", "kept", "all"] = "effective"
    include_unmeasured: bool = False
    boxes: Literal["visible", "amodal"] = "visible"
    images: Literal["copy", "none"] = "copy"
    split: Annotated[float, Field(ge=0, le=1)] = 0.8


class ExportIn(BaseModel):
    """Labels to write."""

    model_config = ConfigDict(extra="forbid")

    format: Literal["yolo", "decisions-jsonl"]
    options: ExportOptions = ExportOptions()


class ExportOut(BaseModel):
    """Labels written, or being written."""

    id: int
    dataset: str
    format: str
    options: dict[str, Any]
    state: str
    size_bytes: int | None
    sha256: str | None
    counts: dict[str, Any] | None
    error: dict[str, Any] | None
    created_at: datetime
    download: str | None
