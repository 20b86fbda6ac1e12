"""The accuracy of the filter and of its channels, and agreement between people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

from pydantic import ConfigDict, Field, ValidationInfo, field_validator

from unghost.wire.model import IfAbsent, RequestModel, ResponseModel
from unghost.wire.words import (
    EvidenceName,
    Refusal,
    ThresholdTarget,
    Truth,
    WrongVerdict,
)

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

    The counts are those of the boxes whose truth is known. With people as the truth,
    the shares are estimates for all boxes, answered or not. Kept is the positive class;
    a share is None where nothing can be said.
    """

    kept_keep: int
    kept_reject: int
    rejected_keep: int
    rejected_reject: int
    precision: Measure | None
    recall: Measure | None
    f1: Measure | None
    refused: Annotated[Refusal | None, IfAbsent(None)] = Field(
        description="Why there is no estimate of a share: nobody has answered boxes in "
        "random order, or too few to know it within 10 percentage points."
    )


class Sample(ResponseModel):
    """The random sample of the boxes that the filter decided and people can judge.

    It is the part of the random order that people have come to. Boxes in it count
    whether or not they were answered in this order.
    """

    boxes: int = Field(description="All such boxes of the dataset.")
    before: int = Field(
        description="Boxes that were answered before the sample was begun. They count "
        "for themselves, and the sample represents the others."
    )
    answered: int = Field(description="Boxes of the sample with keep or reject.")
    unsure: int
    unanswered: int = Field(
        description="Boxes of the sample that were skipped, or uploaded since; the "
        "random order begins with them."
    )


class Plan(ResponseModel):
    """A random sample that would tell how good the filter is."""

    boxes: int = Field(description="Boxes to answer in random order, altogether.")
    half_width: float = Field(
        description="How far the intervals are likely to extend then, to either side, "
        "at most: 0 to 1."
    )


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
    key: Annotated[str, IfAbsent("threshold_small_box")] = Field(
        description="The key of the configuration: `threshold_small_box` of boxes that "
        "tags decide, `min_visible_percent` of those that other evidence decides."
    )
    current: float
    suggested: float
    interval: tuple[float, float] | None
    answers: int = Field(description="Boxes of the class of which the truth is known.")
    f1_current: float | None
    f1_suggested: float | None
    curve: Annotated[tuple[ThresholdPoint, ...], IfAbsent(())]


class Quality(ResponseModel):
    """The accuracy of the filter, and the agreement between people.

    `suggested` thresholds are those for the boxes whose truth is known.
    """

    truth: Annotated[Truth, IfAbsent("people")]
    reviewed: int
    unsure: int
    unmeasured: Annotated[int, IfAbsent(0)] = Field(
        description="Boxes of which the truth is known, but not a verdict of the "
        "filter."
    )
    sample: Annotated[Sample | None, IfAbsent(None)] = Field(
        description="None with instances, which show the truth of every box."
    )
    plan: Annotated[Plan | None, IfAbsent(None)]
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


class LabelCounts(ResponseModel):
    """The labels of an arm: a way of cleaning them."""

    labels: int = Field(description="All boxes that a detector is trained on.")
    ghosts: int = Field(description="Labels of which nothing is visible.")
    doubtful: int = Field(
        description="Labels of objects with too few visible pixels to say."
    )
    lost: int = Field(description="Objects without a label.")


class Difference(Measure):
    """A difference of two shares with its 95 % interval, -1 to 1."""

    shown: bool = Field(
        description="Whether the interval does not contain 0, and all of several seeds "
        "agree."
    )


class Arm(ResponseModel):
    """An arm: what its labels are, and what a detector learns from them."""

    labels: LabelCounts | None = Field(
        description="Null if they were not counted here, but in a joined experiment."
    )
    trials: int = Field(description="Detectors that were trained; 0: none.")
    map50: Measure | None = Field(
        description="Mean of the trials, with its 95 % interval; null without trials."
    )
    difference: Difference | None = Field(
        description="Of mAP50, to that of the baseline."
    )


class Experiment(ResponseModel):
    """What `unghost worth-it` has found out about ways of cleaning labels (arms)."""

    verdict: Annotated[str, Field(max_length=2000)] = Field(
        description="Empty if no detector was trained."
    )
    truth: Annotated[str, Field(max_length=2000)] = Field(
        description="What tells which boxes are objects, in a sentence."
    )
    baseline: Annotated[str, Field(max_length=100)] = Field(
        description="The arm that the others are compared with."
    )
    trainer: Annotated[str, Field(max_length=2000)] = Field(
        description="The value of `--trainer`; empty if no detector was trained."
    )
    frames: int
    objects: int = Field(description="Boxes that are objects by the truth.")
    arms: Annotated[Mapping[str, Arm], Field(max_length=100)] = Field(
        description="By their names, such as `raw` or `ordered@3`."
    )


class ExperimentIn(Experiment):
    """An `Experiment` to keep; unknown keys are refused."""

    model_config = ConfigDict(json_schema_extra=None)


class Evaluation(ResponseModel):
    """Every measured channel against the truth, on the same boxes."""

    truth: Annotated[Truth, IfAbsent("instances")]
    not_measured: Annotated[tuple[EvidenceName, ...], IfAbsent(())]
    frames: int
    boxes: int
    unfiltered: Annotated[Score | None, IfAbsent(None)] = Field(
        description="If every box were kept, as it is recorded."
    )
    channels: Annotated[Mapping[EvidenceName, ChannelScore], IfAbsent({})]
