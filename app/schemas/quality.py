"""The filter against people, as it is answered."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field


class QualityQuery(BaseModel):
    """What is true, and what thresholds are suggested for."""

    model_config = ConfigDict(extra="forbid")

    truth: Literal["people", "instances"] = Field(
        default="people",
        description="What the filter is compared with: people's latest answers, or "
        "instance images, as far as they were measured.",
    )

    target: Literal["f1", "recall"] = Field(
        default="f1",
        description="The best F1, or the highest threshold that keeps `recall`.",
    )
    recall: Annotated[float, Field(gt=0, le=1)] = 0.99


class MeasureOut(BaseModel):
    """A share with its 95 % interval, 0 to 1."""

    value: float
    low: float
    high: float


class ConfusionOut(BaseModel):
    """The filter's word, then the truth's; kept is the positive class."""

    kept_keep: int
    kept_reject: int
    rejected_keep: int
    rejected_reject: int
    precision: MeasureOut | None
    recall: MeasureOut | None
    f1: MeasureOut | None


class BandOut(ConfusionOut):
    """Boxes of one band of distance, in metres."""

    band: str


class ReviewerOut(BaseModel):
    """Boxes by the latest answer of one reviewer."""

    name: str
    answers: int
    keep: int
    reject: int
    unsure: int


class PairOut(BaseModel):
    """Two reviewers and the boxes that both decided."""

    a: str
    b: str
    boxes: int
    agreed: int
    kappa: float | None


class AgreementOut(BaseModel):
    """Boxes that two or more reviewers decided."""

    boxes: int
    agreed: int
    percent: float | None
    kappa: float | None = Field(description="Cohen's, of all pairs in one table.")
    interval: tuple[float, float] | None
    pairs: list[PairOut]


class PointOut(BaseModel):
    """The scores of one threshold."""

    threshold: float
    precision: float | None
    recall: float | None
    f1: float | None


class SuggestionOut(BaseModel):
    """The threshold of a class that the truth speaks for."""

    model_config = ConfigDict(populate_by_name=True)

    class_name: str = Field(alias="class")
    current: float
    suggested: float
    interval: tuple[float, float] | None
    answers: int = Field(description="Boxes of the class whose truth is known.")
    f1_current: float | None
    f1_suggested: float | None
    curve: list[PointOut]


class QualityOut(BaseModel):
    """What the truth says about the filter, and people about each other."""

    truth: str
    reviewed: int
    unsure: int
    unmeasured: int = Field(
        description="Boxes of known truth without a verdict of the filter."
    )
    confusion: ConfusionOut
    by_class: dict[str, ConfusionOut]
    by_distance: list[BandOut]
    reviewers: list[ReviewerOut]
    agreement: AgreementOut
    suggested: list[SuggestionOut]
