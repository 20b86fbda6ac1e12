"""Answers of people as they are sent and answered."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.repositories.box_filter import REVIEW_STATES

Answer = Literal["keep", "reject", "unsure", "clear"]
Comment = Annotated[str, Field(max_length=2000, pattern=r"^[^\x00]*$")]
Percent = Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]
Metres = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Id = Annotated[int, Field(ge=1, le=2**63 - 1)]
Revision = Annotated[int, Field(ge=0, le=2**31 - 1)]


class ReviewIn(BaseModel):
    """An answer on one box as it was seen."""

    model_config = ConfigDict(extra="forbid")

    verdict: Answer
    comment: Comment = ""
    seen_revision: Revision = Field(
        description="The box's `revision` that was seen: 0 if it was never answered."
    )


class ReviewOut(BaseModel):
    """An answer as it is stored."""

    box_id: int
    revision: int
    verdict: str
    reviewer: str
    comment: str
    created_at: datetime
    effective_verdict: str


def _one_of_the_states(schema: dict[str, Any]) -> None:
    schema["enum"] = ["", *REVIEW_STATES, None]


class BoxSelection(BaseModel):
    """Boxes of a list, by the same filters that the list takes."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    verdict: Literal["kept", "rejected", "unmeasured"] | None = None
    effective: Literal["kept", "rejected", "unmeasured"] | None = None
    reason: Annotated[
        str | None, Field(description="Reasons, separated by commas.")
    ] = None
    class_name: str | None = Field(default=None, alias="class")
    review: Annotated[str | None, Field(json_schema_extra=_one_of_the_states)] = None
    toss_up: bool | None = None
    conflict: bool | None = Field(
        default=None,
        description="Whether a person's keep or reject contradicts the filter.",
    )
    match_min: Percent | None = None
    match_max: Percent | None = None
    margin_max: Percent | None = None
    distance_min: Metres | None = None
    distance_max: Metres | None = None


class BulkIn(BaseModel):
    """One answer on many boxes: listed, or all of a filter, as they were seen."""

    model_config = ConfigDict(extra="forbid")

    dataset: Annotated[str, Field(max_length=100)]
    box_ids: Annotated[list[Id], Field(fail_fast=True)] | None = None
    seen_revisions: Annotated[list[Revision], Field(fail_fast=True)] | None = Field(
        default=None,
        description="The `revision` that was seen of each of `box_ids`, in their "
        "order; boxes that were answered since are left alone. Without it, boxes "
        "that have an answer are left alone.",
    )
    filter: BoxSelection | None = None
    snapshot: Annotated[str, Field(max_length=1000)] | None = Field(
        default=None,
        description="Of the list with this filter that was seen: `snapshot` of "
        "`GET /api/v1/boxes?count=true`. 412 if its boxes are not as they were then.",
    )
    expected_count: Annotated[int, Field(ge=0)] | None = Field(
        default=None, description="409 unless so many boxes are listed or selected."
    )
    verdict: Answer
    comment: Comment = ""


class BulkOut(BaseModel):
    """A batch of answers: one act, one undo."""

    id: int
    dataset: str
    verdict: str
    count: int = Field(description="Boxes that were answered.")
    skipped: list[int] = Field(
        description="Boxes that are gone, or of another dataset."
    )
    stale: list[int] = Field(
        description="Boxes that were left alone because somebody answered them since."
    )


class UndoOut(BaseModel):
    """What an undo put back, and what someone had changed since."""

    id: int
    undone: int
    skipped: list[int]


class HistoryOut(BaseModel):
    """What happened to a box, newest first."""

    items: list[dict[str, Any]]
