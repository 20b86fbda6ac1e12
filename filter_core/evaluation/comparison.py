"""Compares the kinds of evidence with the ground truth.

`Evaluation` takes, frame by frame, evidence of boxes and whether each object is
visible. Every kind of evidence decides all boxes under the same configuration. The
results are counts by class and distance, and the largest errors. Without people's
answers, `truth_from_instances` takes the ground truth from instance images.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeAlias, TypedDict

import numpy as np

from filter_core.config.filter import FilterConfig
from filter_core.decisions.channel_rules import has_number
from filter_core.decisions.rules import decide
from filter_core.evaluation.scores import (
    BANDS,
    Confusion,
    ConfusionObject,
    band_index,
)
from filter_core.evidence_kinds import CHANNELS, SEMANTIC, EvidenceName
from filter_core.types import (
    NOT_MEASURED,
    UNMEASURED,
    VERDICT_OF_REASON,
    BoolArray,
    Evidence,
    IntArray,
    Reason,
)

COMPARED: Final[tuple[EvidenceName, ...]] = (SEMANTIC, *CHANNELS)
"""The kinds of evidence that can be compared."""

MOST: Final = 20
"""How many errors are listed for each kind of evidence."""

WrongVerdict: TypeAlias = Literal["kept_hidden", "rejected_visible"]
"""The two ways in which a verdict can be wrong."""

NameOf: TypeAlias = Callable[[int], Mapping[str, object]]
"""Gives the name of a box from its row; called only for boxes that are listed."""


def _by_row(row: int) -> dict[str, int]:
    return {"row": row}


class BandObject(ConfusionObject):
    """The counts of one band of distance as JSON."""

    band: str


class ScoreObject(ConfusionObject):
    """A `ChannelScore` as JSON: all boxes together, then parts of them."""

    judged: int
    by_class: dict[str, ConfusionObject]
    by_distance: list[BandObject]
    worst: list[dict[str, object]]


class EvaluationObject(TypedDict):
    """An `Evaluation` as JSON; `channels` are the scores by kind of evidence."""

    frames: int
    boxes: int
    channels: dict[EvidenceName, ScoreObject]


class Evaluation:
    """Decides boxes by several kinds of evidence and counts right and wrong verdicts.

    Parameters
    ----------
    config : FilterConfig
        Thresholds and ranges; its key ``evidence`` is not used.
    channels : tuple of EvidenceName
        The kinds of evidence that are compared.
    """

    def __init__(
        self, config: FilterConfig, channels: tuple[EvidenceName, ...] = COMPARED
    ) -> None:
        self.configs = {name: replace(config, evidence=name) for name in channels}
        self.scores = {name: ChannelScore() for name in channels}
        self.boxes = 0
        self.frames = 0

    def add(
        self,
        evidence: Evidence,
        visible: BoolArray,
        frames: int = 1,
        name_of: NameOf = _by_row,
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
        self.boxes += len(evidence)
        bands = band_index(evidence.distance)
        for channel, config in self.configs.items():
            reason = decide(evidence, config).reason
            judged = VERDICT_OF_REASON[reason] != UNMEASURED
            kept = reason == Reason.VISIBLE
            outcomes = _Outcomes(kept[judged], visible[judged])
            score = self.scores[channel]
            classes = evidence.class_index[judged].astype(np.int64)
            outcomes.count(classes, evidence.class_names, score.by_class)
            outcomes.count(bands[judged], BANDS, score.by_band)
            own = has_number(evidence, channel)
            score.judged += int(np.count_nonzero(own & judged))
            score.worst.add(evidence, kept, np.where(judged, visible, kept), name_of)

    def as_dict(self) -> EvaluationObject:
        """The whole comparison, ready for JSON."""
        return {
            "frames": self.frames,
            "boxes": self.boxes,
            "channels": {name: one.as_dict() for name, one in self.scores.items()},
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
        pixels = _wrong_pixels(evidence.take(rows), kept[rows])
        # Stable, so that the order of equal errors is always the same.
        largest = np.argsort(-pixels, kind="stable")[:MOST]
        found = [
            WrongBox(
                name_of(int(rows[place])),
                "kept_hidden" if kept[rows[place]] else "rejected_visible",
                int(pixels[place]),
            )
            for place in largest.tolist()
        ]
        merged = sorted([*self.boxes, *found], key=lambda box: -box.pixels)
        self.boxes = merged[:MOST]


def _wrong_pixels(evidence: Evidence, kept: BoolArray) -> IntArray:
    seen = evidence.matched_pixels
    if evidence.channels is not None:
        by_instance = evidence.channels.instance_pixels
        seen = np.where(by_instance > 0, by_instance, seen)
    pixels: IntArray = np.where(kept, evidence.box_pixels, seen)
    return pixels


@dataclass
class ChannelScore:
    """The right and wrong verdicts of one kind of evidence so far.

    Attributes
    ----------
    by_class, by_band : dict of Confusion
    judged : int
        Boxes that it had a number for; the segmentation judged the others.
    worst : LargestErrors
        The largest errors.
    """

    by_class: dict[str, Confusion] = field(default_factory=dict)
    by_band: dict[str, Confusion] = field(default_factory=dict)
    judged: int = 0
    worst: LargestErrors = field(default_factory=LargestErrors)

    @property
    def total(self) -> Confusion:
        """All boxes together."""
        return sum(self.by_band.values(), start=Confusion())

    def as_dict(self) -> ScoreObject:
        """Ready for JSON; classes by name, bands from near to far."""
        bands = [name for name in BANDS if name in self.by_band]
        return {
            **self.total.as_dict(),
            "judged": self.judged,
            "by_class": {
                name: one.as_dict() for name, one in sorted(self.by_class.items())
            },
            "by_distance": [
                {"band": name, **self.by_band[name].as_dict()} for name in bands
            ],
            "worst": [box.as_dict() for box in self.worst.boxes],
        }


@dataclass(frozen=True, eq=False)
class _Outcomes:
    """Whether each of N boxes was kept, and whether it is visible."""

    kept: BoolArray
    visible: BoolArray

    def count(
        self, group: IntArray, names: Sequence[str], into: dict[str, Confusion]
    ) -> None:
        """Add the counts of each group to `into`; `group` (N,) indexes `names`."""
        code = group * 4 + self.kept * 2 + self.visible
        counts = np.bincount(code, minlength=4 * len(names)).reshape(-1, 4).tolist()
        for name, (hidden, lost, ghosts, found) in zip(names, counts, strict=True):
            if hidden + lost + ghosts + found:
                counted = Confusion(found, ghosts, lost, hidden)
                into[name] = into.get(name, Confusion()) + counted


def truth_from_instances(evidence: Evidence) -> tuple[IntArray, BoolArray]:
    """The truth from instance images: whether the objects of boxes are visible.

    Returns
    -------
    rows : (M,) int64
        The boxes that had an instance image.
    visible : (M,) bool
        Whether at least one pixel of its instance is visible.
    """
    channels = evidence.channels
    if channels is None:
        return np.empty(0, np.int64), np.empty(0, np.bool_)
    rows = np.flatnonzero(channels.instance_pixels != NOT_MEASURED)
    return rows, channels.instance_pixels[rows] > 0
