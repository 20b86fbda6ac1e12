"""Comparisons of channels as they are answered."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from app.schemas.quality import MeasureOut


class EvaluationQuery(BaseModel):
    """What the channels are compared with."""

    model_config = ConfigDict(extra="forbid")

    truth: Literal["instances", "people"] = Field(
        default="instances",
        description="What is visible: boxes whose instance has a pixel, or boxes that "
        "people kept.",
    )


class ScoreOut(BaseModel):
    """Verdicts against the truth; kept is the positive class."""

    kept_visible: int
    kept_hidden: int
    rejected_visible: int
    rejected_hidden: int
    precision: MeasureOut | None
    recall: MeasureOut | None
    f1: MeasureOut | None


class BandScoreOut(ScoreOut):
    """The boxes of one band of distance, in metres."""

    band: str


class WrongBoxOut(BaseModel):
    """A box that a channel got wrong."""

    box_id: int
    frame_id: int
    error: Literal["kept_hidden", "rejected_visible"]
    pixels: int = Field(
        description="Of a kept ghost all of its box, of a lost object those seen of it."
    )


class ChannelScoreOut(ScoreOut):
    """One channel: all boxes, by class and by distance."""

    judged: int = Field(
        description="Boxes it had a number for; the segmentation judged the others."
    )
    by_class: dict[str, ScoreOut]
    by_distance: list[BandScoreOut]
    worst: list[WrongBoxOut] = Field(
        description="Up to 20 boxes that it got wrong, most pixels first."
    )


class EvaluationOut(BaseModel):
    """Every measured channel against the truth, on the same boxes."""

    truth: str
    not_measured: list[str]
    frames: int
    boxes: int
    channels: dict[str, ChannelScoreOut]
