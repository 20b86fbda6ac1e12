"""The accuracy of the filter and of its channels, and agreement between people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

from pydantic import Field, ValidationInfo, field_validator

from unghost.wire.model import IfAbsent, RequestModel, ResponseModel
from unghost.wire.words import EvidenceName, ThresholdTarget, Truth, WrongVerdict

_RECALL: Final = 0.99


class QualityQuery(RequestModel):
    """The ground truth of the comparison, and the goal of suggested thresholds."""

    truth: Truth = Field(
        default="people",
        description="What the filter is compared with. people: their latest answers; "
        "instances: instance images, where frames have them.",
    )
    target: ThresholdTarget = Field(
        default="f1",
        description="What a suggested threshold is for. f1: the best F1; recall: the "
        "highest threshold that reaches `recall`.",
    )
    recall: Annotated[
        float, Field(gt=0, le=1, description="For the target recall only.")
    ] = _RECALL

    @field_validator("recall")
    @classmethod
    def _refuse_unused_recall(cls, recall: float, place: ValidationInfo) -> float:
        # Some versions of FastAPI pass the default as if it had been sent.
        if place.data.get("target") == "f1" and recall != _RECALL:
            raise ValueError("has no effect without target=recall")
        return recall


class EvaluationQuery(RequestModel):
    """The ground truth with which the channels are compared."""

    truth: Truth = Field(
        default="instances",
        description="Which boxes count as visible. instances: boxes whose instance has "
        "a pixel; people: boxes that people kept.",
    )


class Measure(ResponseModel):
    """A share with its 95 % interval, 0 to 1."""

    value: float
    low: float
    high: float


class _OfOneBand(ResponseModel):
    band: str = Field(description="A band of distance, in metres.")


class Confusion(ResponseModel):
    """Boxes by the verdict of the filter, then by the ground truth.

    Kept is the positive class; a share is None where nothing can be said.
    """

    kept_keep: int
    kept_reject: int
    rejected_keep: int
    rejected_reject: int
    precision: Measure | None
    recall: Measure | None
    f1: Measure | None


class Band(Confusion, _OfOneBand):
    """Boxes of one band of distance, in metres."""


class Reviewer(ResponseModel):
    """Boxes by the latest answer of one reviewer."""

    name: str
    answers: int
    keep: int
    reject: int
    unsure: int


class Pair(ResponseModel):
    """Two reviewers and the boxes that both decided; `kappa` is Cohen's."""

    a: str
    b: str
    boxes: int
    agreed: int
    kappa: float | None


class Agreement(ResponseModel):
    """Boxes that two or more reviewers decided; `interval` is that of `kappa`."""

    boxes: int
    agreed: int
    percent: float | None
    kappa: float | None = Field(description="Cohen's kappa, of all pairs in one table.")
    interval: tuple[float, float] | None
    pairs: Annotated[tuple[Pair, ...], IfAbsent(())]


class ThresholdPoint(ResponseModel):
    """The scores that a threshold would have."""

    threshold: float
    precision: float | None
    recall: float | None
    f1: float | None


class Suggestion(ResponseModel):
    """The suggested threshold of a class, and the current one."""

    class_name: str = Field(alias="class")
    current: float
    suggested: float
    interval: tuple[float, float] | None
    answers: int = Field(description="Boxes of the class of which the truth is known.")
    f1_current: float | None
    f1_suggested: float | None
    curve: Annotated[tuple[ThresholdPoint, ...], IfAbsent(())]


class Quality(ResponseModel):
    """The accuracy of the filter, and the agreement between people."""

    truth: Annotated[Truth, IfAbsent("people")]
    reviewed: int
    unsure: int
    unmeasured: Annotated[int, IfAbsent(0)] = Field(
        description="Boxes of which the truth is known, but not a verdict of the "
        "filter."
    )
    confusion: Confusion
    by_class: Annotated[Mapping[str, Confusion], IfAbsent({})]
    by_distance: Annotated[tuple[Band, ...], IfAbsent(())]
    reviewers: Annotated[tuple[Reviewer, ...], IfAbsent(())]
    agreement: Agreement
    suggested: Annotated[tuple[Suggestion, ...], IfAbsent(())]


class Score(ResponseModel):
    """A channel's verdicts compared with the visibility of the objects.

    Kept is the positive class; a share is None where nothing can be said.
    """

    kept_visible: int
    kept_hidden: int
    rejected_visible: int
    rejected_hidden: int
    precision: Measure | None
    recall: Measure | None
    f1: Measure | None


class BandScore(Score, _OfOneBand):
    """Boxes of one band of distance, in metres."""


class WrongBox(ResponseModel):
    """A box that a channel got wrong."""

    box_id: int
    frame_id: int
    error: WrongVerdict
    pixels: int = Field(
        description="Of a ghost that was kept: all of its box. Of a visible object "
        "that was rejected: those that are visible."
    )


class ChannelScore(Score):
    """The accuracy of one channel: on all boxes, by class and by distance."""

    judged: int = Field(
        description="Boxes that the channel had a number for; the segmentation judged "
        "the others."
    )
    by_class: Annotated[Mapping[str, Score], IfAbsent({})]
    by_distance: Annotated[tuple[BandScore, ...], IfAbsent(())]
    worst: Annotated[tuple[WrongBox, ...], IfAbsent(())] = Field(
        description="Up to 20 boxes that the channel got wrong, most pixels first."
    )


class Evaluation(ResponseModel):
    """Every measured channel against the truth, on the same boxes."""

    truth: Annotated[Truth, IfAbsent("instances")]
    not_measured: Annotated[tuple[EvidenceName, ...], IfAbsent(())]
    frames: int
    boxes: int
    channels: Annotated[Mapping[EvidenceName, ChannelScore], IfAbsent({})]
