"""Compares the kinds of evidence with the ground truth.

`Evaluation` takes, frame by frame, evidence of boxes and whether each object is
visible. Every kind of evidence decides all boxes under the same configuration. The
results are counts by class and distance, and the largest errors. Without people's
answers, `truth_from_instances` takes the ground truth from instance images.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal, Protocol, TypeAlias, TypedDict

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import NOT_MEASURED, BoolArray, FloatArray, IntArray
from filter_core.config.filter import FilterConfig
from filter_core.decisions.channel_rules import has_number
from filter_core.decisions.rules import decide
from filter_core.evaluation.scores import BANDS, Confusion, ConfusionObject, band_index
from filter_core.evidence_kinds import CHANNELS, SEMANTIC, EvidenceName
from filter_core.evidence_numbers import Evidence
from filter_core.verdicts import UNMEASURED, VERDICT_OF_REASON, Reason

COMPARED: Final[tuple[EvidenceName, ...]] = (SEMANTIC, *CHANNELS)
"""The kinds of evidence that can be compared."""

MOST: Final = 20
"""How many errors are listed for each kind of evidence."""

WrongVerdict: TypeAlias = Literal["kept_hidden", "rejected_visible"]
"""The two ways in which a verdict can be wrong."""

NameOf: TypeAlias = Callable[[int], Mapping[str, object]]
"""Gives the name of a box from its row; called only for boxes that are listed."""


class BandObject(ConfusionObject):
    """The counts of one band of distance as JSON."""

    band: str


class PartsObject(ConfusionObject):
    """`PartCounts` as JSON: all boxes together, then parts of them."""

    by_class: dict[str, ConfusionObject]
    by_distance: list[BandObject]


class ScoreObject(PartsObject):
    """A `ChannelScore` as JSON."""

    judged: int
    worst: list[dict[str, object]]


class EvaluationObject(TypedDict):
    """An `Evaluation` as JSON.

    `unfiltered` is the score if every box were kept, `channels` are those by kind of
    evidence.
    """

    frames: int
    boxes: int
    unfiltered: ConfusionObject
    channels: dict[EvidenceName, ScoreObject]


class Evaluation:
    """Decides boxes by several kinds of evidence and counts right and wrong verdicts.

    Of `config`, the key ``evidence`` is not used: `channels` are compared.
    """

    def __init__(
        self, config: FilterConfig, channels: tuple[EvidenceName, ...] = COMPARED
    ) -> None:
        self.configs = {name: replace(config, evidence=name) for name in channels}
        self.scores = {name: ChannelScore() for name in channels}
        self.unfiltered = Confusion()
        self.frames = 0

    def add(
        self,
        evidence: Evidence,
        visible: BoolArray,
        frames: int = 1,
        name_of: NameOf = lambda row: {"row": row},
    ) -> None:
        """Count the boxes of one or more frames; unmeasured ones are left out.

        Parameters
        ----------
        evidence : Evidence of N boxes
        visible : (N,) bool
            Whether each object is visible: the truth.
        frames : int
            How many frames the boxes are of.
        name_of : callable
            Gives the name of a box that is listed as an error, from its row.
        """
        self.frames += frames
        self.unfiltered += Confusion.of(np.ones_like(visible), visible)
        for channel, config in self.configs.items():
            reason = decide(evidence, config).reason
            judged = VERDICT_OF_REASON[reason] != UNMEASURED
            kept = reason == Reason.VISIBLE
            score = self.scores[channel]
            score.count(evidence, kept, visible, judged)
            own = has_number(evidence, channel)
            score.judged += int(np.count_nonzero(own & judged))
            score.worst.add(evidence, kept, np.where(judged, visible, kept), name_of)

    def as_dict(self) -> EvaluationObject:
        """The whole comparison, ready for JSON."""
        return {
            "frames": self.frames,
            "boxes": self.unfiltered.boxes,
            "unfiltered": self.unfiltered.as_dict(),
            "channels": {name: score.as_dict() for name, score in self.scores.items()},
        }


@dataclass(frozen=True)
class WrongBox:
    """A box whose verdict is wrong.

    Attributes
    ----------
    name : mapping
        What identifies the box in its source, such as frame and id.
    error : WrongVerdict
        A field of `Confusion`.
    pixels : int
        The size of the error. If a ghost was kept: the pixels of its box. If a visible
        object was rejected: its visible pixels, by its instance or else its tags.
    """

    name: Mapping[str, object]
    error: WrongVerdict
    pixels: int

    def as_dict(self) -> dict[str, object]:
        """Ready for JSON."""
        return {**self.name, "error": self.error, "pixels": self.pixels}


@dataclass
class LargestErrors:
    """The `MOST` largest errors so far by pixels, largest first."""

    boxes: list[WrongBox] = field(default_factory=list)

    def add(
        self, evidence: Evidence, kept: BoolArray, visible: BoolArray, name_of: NameOf
    ) -> None:
        """Add the errors among N boxes.

        `kept` (N,) are the verdicts, `visible` (N,) the truth; `name_of` names boxes by
        their rows.
        """
        rows = np.flatnonzero(kept != visible)
        wrong = evidence.take(rows)
        seen = wrong.matched_pixels
        if wrong.channels is not None:
            by_instance = wrong.channels.instance_pixels
            seen = np.where(by_instance > 0, by_instance, seen)
        pixels: IntArray = np.where(kept[rows], wrong.box_pixels, seen)
        # Stable, so that the order of equal errors is always the same.
        largest = np.argsort(-pixels, kind="stable")[:MOST]
        boxes = [
            WrongBox(
                name_of(int(rows[place])),
                "kept_hidden" if kept[rows[place]] else "rejected_visible",
                int(pixels[place]),
            )
            for place in largest.tolist()
        ]
        merged = sorted([*self.boxes, *boxes], key=lambda box: -box.pixels)
        self.boxes = merged[:MOST]


class WithClasses(Protocol):
    """N boxes with classes and distances, under the attributes of `Evidence`.

    `class_index` (N,) are places in `class_names`; `distance` (N,), metres, is NaN
    where it is not known.
    """

    @property
    def class_names(self) -> tuple[str, ...]: ...
    @property
    def class_index(self) -> NDArray[np.int32]: ...
    @property
    def distance(self) -> FloatArray: ...


@dataclass
class PartCounts:
    """Right and wrong verdicts so far, by class and by band of distance."""

    by_class: dict[str, Confusion] = field(default_factory=dict)
    by_band: dict[str, Confusion] = field(default_factory=dict)

    def count(
        self, boxes: WithClasses, kept: BoolArray, visible: BoolArray, rows: BoolArray
    ) -> None:
        """Count those of N boxes for which `rows` (N,) is True."""
        code = kept[rows] * 2 + visible[rows]
        for group, names, into in (
            (boxes.class_index.astype(np.int64), boxes.class_names, self.by_class),
            (band_index(boxes.distance), BANDS, self.by_band),
        ):
            counts = np.bincount(group[rows] * 4 + code, minlength=4 * len(names))
            for name, (hidden, lost, ghosts, objects) in zip(
                names, counts.reshape(-1, 4).tolist(), strict=True
            ):
                if hidden + lost + ghosts + objects:
                    counted = Confusion(objects, ghosts, lost, hidden)
                    into[name] = into.get(name, Confusion()) + counted

    @property
    def total(self) -> Confusion:
        """All boxes together."""
        return sum(self.by_band.values(), start=Confusion())

    def parts(self) -> PartsObject:
        """Ready for JSON; classes by name, bands from near to far."""
        return {
            **self.total.as_dict(),
            "by_class": {
                name: confusion.as_dict()
                for name, confusion in sorted(self.by_class.items())
            },
            "by_distance": [
                {"band": name, **self.by_band[name].as_dict()}
                for name in BANDS
                if name in self.by_band
            ],
        }


@dataclass
class ChannelScore(PartCounts):
    """The right and wrong verdicts of one kind of evidence so far.

    It has the largest errors, too. `judged` counts the boxes that it had a number for;
    the segmentation judged the others.
    """

    judged: int = 0
    worst: LargestErrors = field(default_factory=LargestErrors)

    def as_dict(self) -> ScoreObject:
        """Ready for JSON."""
        parts = self.parts()
        return {
            **self.total.as_dict(),
            "judged": self.judged,
            "by_class": parts["by_class"],
            "by_distance": parts["by_distance"],
            "worst": [box.as_dict() for box in self.worst.boxes],
        }


def truth_from_instances(evidence: Evidence) -> tuple[IntArray, BoolArray]:
    """The truth from instance images: whether the objects of boxes are visible.

    (M,) int64: the rows of boxes that had an instance image; and (M,) bool: whether at
    least one pixel of its instance is visible.
    """
    channels = evidence.channels
    if channels is None:
        return np.empty(0, np.int64), np.empty(0, np.bool_)
    rows = np.flatnonzero(channels.instance_pixels != NOT_MEASURED)
    return rows, channels.instance_pixels[rows] > 0
