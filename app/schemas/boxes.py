"""Boxes in lists: what can be asked for, and what a decision looks like."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from app.schemas.pages import Page
from app.schemas.reviews import BoxSelection

Sort = Literal["id", "doubt", "match_percent", "-match_percent", "crowding"]


FrameSort = Literal["key", "-key", "id", "-id"]


class BoxListQuery(BoxSelection):
    """The query of a list of boxes."""

    dataset: str = Field(description="Name of the dataset.")
    sort: Sort = "id"
    limit: int = Field(default=100, ge=1, le=1000, description="Most items of a page.")
    cursor: str | None = Field(default=None, max_length=2000)
    count: bool = Field(
        default=False, description="Whether to answer the `total` of the filter too."
    )


class FrameListQuery(BoxSelection):
    """The query of a list of frames: those that have such a box."""

    key: str = Field(default="", max_length=512, description="Prefix of keys.")
    sort: FrameSort = "key"
    limit: int = Field(default=100, ge=1, le=1000, description="Most items of a page.")
    cursor: str | None = Field(default=None, max_length=2000)


class HiddenByOut(BaseModel):
    """A tag that covers part of a box and is not accepted."""

    tag: int
    name: str
    percent: float


class AcceptedTagOut(BaseModel):
    """A tag whose pixels count for a box."""

    tag: int
    name: str
    rgb: list[int]


class CurrentReviewOut(BaseModel):
    """What a person last said of a box."""

    verdict: str
    reviewer: str
    revision: int
    comment: str


class DecisionOut(BaseModel):
    """One box, its verdict and everything the verdict rests on."""

    model_config = ConfigDict(populate_by_name=True)

    id: str = Field(description="The sender's own id.")
    box_id: int
    frame: str = Field(description="The frame's key.")
    frame_id: int
    class_name: str = Field(alias="class")
    verdict: Literal["kept", "rejected", "unmeasured"]
    reason: str
    explanation: str
    evidence: str | None
    match_percent: float | None
    threshold: float | None
    margin: float | None
    toss_up: bool
    large: bool
    matched_pixels: int | None
    box_pixels: int | None
    area_percent: float | None
    crowding: float | None
    explained_by: str | None
    hidden_by: list[HiddenByOut]
    accepted_tags: list[AcceptedTagOut]
    lossy: bool
    distance: float | None
    xyxy: list[float] | None
    amodal_xyxy: list[float] | None
    visible_xyxy: list[float] | None
    tight_xyxy: list[float] | None
    visible_pixels: int | None
    occluded: Literal[0, 1, 2, 3]
    truncated: float | None
    edges: list[list[float]] | None
    config: str
    run: int
    revision: int = Field(
        description="How many answers the box has got, those that were taken back "
        "included: the `seen_revision` of the next one."
    )
    review: CurrentReviewOut | None = Field(
        description="The answer in force; null if there is none, or none any more."
    )
    effective_verdict: Literal["kept", "rejected", "unmeasured"]


class BoxPage(Page[DecisionOut]):
    """One page of boxes."""

    total: int | None = Field(
        default=None, description="All boxes of the filter, exactly; with `count=true`."
    )
    snapshot: str | None = Field(
        default=None,
        description="Stands for these boxes as they are now; with `count=true`. One "
        "answer on all of them names it.",
    )


class BoxOut(DecisionOut):
    """A box with the boxes around it."""

    neighbours: list[int] = Field(description="Boxes of the frame that overlap it.")
