"""What the server says of the filter's quality: against people, against instances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from unghost.reading import Result

Goal: TypeAlias = Literal["f1", "recall"]
Truth: TypeAlias = Literal["instances", "people"]


@dataclass(frozen=True, kw_only=True)
class Measure(Result):
    """A share with its interval of 95 %."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class _Shares(Result):
    """Kept is the positive class; None where nothing can be said."""

    precision: Measure | None = None
    recall: Measure | None = None
    f1: Measure | None = None


@dataclass(frozen=True, kw_only=True)
class Confusion(_Shares):
    """The filter's verdict, then the answer that is held to be true."""

    kept_keep: int = 0
    kept_reject: int = 0
    rejected_keep: int = 0
    rejected_reject: int = 0


@dataclass(frozen=True, kw_only=True)
class Band(Confusion):
    """Boxes of one band of distance, in metres."""

    band: str


@dataclass(frozen=True, kw_only=True)
class Reviewer(Result):
    """Boxes by the latest answer of one reviewer."""

    name: str
    answers: int = 0
    keep: int = 0
    reject: int = 0
    unsure: int = 0


@dataclass(frozen=True, kw_only=True)
class Pair(Result):
    """Two reviewers and the boxes that both decided; `kappa` is Cohen's."""

    a: str
    b: str
    boxes: int = 0
    agreed: int = 0
    kappa: float | None = None


@dataclass(frozen=True, kw_only=True)
class Agreement(Result):
    """Boxes that two or more reviewers decided; `interval` is that of `kappa`."""

    boxes: int = 0
    agreed: int = 0
    percent: float | None = None
    kappa: float | None = None
    interval: tuple[float, float] | None = None
    pairs: tuple[Pair, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ThresholdPoint(Result):
    """The scores that a threshold would have."""

    threshold: float
    precision: float | None = None
    recall: float | None = None
    f1: float | None = None


@dataclass(frozen=True, kw_only=True)
class Suggestion(Result):
    """The threshold of a class that its answers speak for."""

    class_name: str = field(metadata={"key": "class"})
    current: float
    suggested: float
    interval: tuple[float, float] | None = None
    answers: int = 0
    f1_current: float | None = None
    f1_suggested: float | None = None
    curve: tuple[ThresholdPoint, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Quality(Result):
    """How good the filter is by the truth, and how far people agree themselves."""

    truth: Truth = "people"
    reviewed: int = 0
    unsure: int = 0
    unmeasured: int = 0
    confusion: Confusion = field(default_factory=Confusion)
    by_class: Mapping[str, Confusion] = field(default_factory=dict)
    by_distance: tuple[Band, ...] = ()
    reviewers: tuple[Reviewer, ...] = ()
    agreement: Agreement = field(default_factory=Agreement)
    suggested: tuple[Suggestion, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Score(_Shares):
    """A channel's verdicts against what is visible."""

    kept_visible: int = 0
    kept_hidden: int = 0
    rejected_visible: int = 0
    rejected_hidden: int = 0


@dataclass(frozen=True, kw_only=True)
class BandScore(Score):
    """Boxes of one band of distance, in metres."""

    band: str


@dataclass(frozen=True, kw_only=True)
class WrongBox(Result):
    """A box that a channel got wrong: `kept_hidden` or `rejected_visible`."""

    box_id: int
    frame_id: int
    error: str
    pixels: int = 0


@dataclass(frozen=True, kw_only=True)
class ChannelScore(Score):
    """One channel; `judged` boxes had its number, the others the segmentation's."""

    judged: int = 0
    by_class: Mapping[str, Score] = field(default_factory=dict)
    by_distance: tuple[BandScore, ...] = ()
    worst: tuple[WrongBox, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Evaluation(Result):
    """Every measured channel against the truth, on the same boxes."""

    truth: Truth = "instances"
    not_measured: tuple[str, ...] = ()
    frames: int = 0
    boxes: int = 0
    channels: Mapping[str, ChannelScore] = field(default_factory=dict)
