"""Kinds of evidence compared with the truth: what each gets right, and the worst boxes.

Numbers of boxes and whether each object is visible come in, frame by frame. Each kind
of evidence decides them under the same thresholds; counts by class and distance, and
the largest disagreements, come out. Where nobody has said what is visible,
`truth_from_instances` takes it from instance images.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, TypeAlias

import numpy as np

from filter_core.config.filter import FilterConfig
from filter_core.config.keys import CHANNELS, SEMANTIC
from filter_core.decisions.channels import has_number
from filter_core.decisions.rules import decide
from filter_core.evaluation.scores import BANDS, Confusion, band_index
from filter_core.types import (
    NOT_MEASURED,
    BoolArray,
    Evidence,
    IntArray,
    Reason,
)

COMPARED: Final = (SEMANTIC, *CHANNELS)
"""The kinds of evidence that can be compared."""

MOST: Final = 20
"""Disagreements that are listed of each kind of evidence."""

NameOf: TypeAlias = Callable[[int], Mapping[str, Any]]
"""What a box is called, by its row; asked only of those that are listed."""


def _by_row(row: int) -> dict[str, int]:
    return {"row": row}


class Evaluation:
    """Counts frames, one after the other, under every channel that was measured.

    Parameters
    ----------
    config : FilterConfig
        Its thresholds and ranges; its own channel is not looked at.
    channels : names out of `COMPARED`
    """

    def __init__(
        self, config: FilterConfig, channels: tuple[str, ...] = COMPARED
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
        """Count boxes of one or more frames; `visible` (N,) is the truth.

        Boxes that nothing can judge are left out: they are unmeasured, not rejected.
        """
        self.frames += frames
        self.boxes += len(evidence)
        bands = band_index(evidence.distance)
        for channel, config in self.configs.items():
            reason = decide(evidence, config).reason
            judged = reason != Reason.NO_SEGMENTATION
            kept = reason == Reason.VISIBLE
            outcomes = _Outcomes(kept[judged], visible[judged])
            score = self.scores[channel]
            classes = evidence.class_index[judged].astype(np.int64)
            outcomes.count(classes, evidence.class_names, score.by_class)
            outcomes.count(bands[judged], BANDS, score.by_band)
            own = has_number(evidence, channel)
            score.judged += int(np.count_nonzero(own & judged))
            score.worst.add(evidence, kept, np.where(judged, visible, kept), name_of)

    def as_dict(self) -> dict[str, Any]:
        """The whole comparison, ready for JSON."""
        return {
            "frames": self.frames,
            "boxes": self.boxes,
            "channels": {name: one.as_dict() for name, one in self.scores.items()},
        }


@dataclass(frozen=True)
class WrongBox:
    """One disagreement.

    Attributes
    ----------
    name : mapping
        What the box is called where it comes from.
    error : str
        ``kept_hidden`` or ``rejected_visible``, as a confusion counts it.
    pixels : int
        Of a ghost that was kept: all of its box. Of a visible object that was lost:
        those seen of it, by its instance or else by the tags that its class accepts.
    """

    name: Mapping[str, Any]
    error: str
    pixels: int

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {**self.name, "error": self.error, "pixels": self.pixels}


@dataclass
class Worst:
    """The `MOST` largest disagreements so far, in pixels, largest first."""

    boxes: list[WrongBox] = field(default_factory=list)

    def add(
        self, evidence: Evidence, kept: BoolArray, visible: BoolArray, name_of: NameOf
    ) -> None:
        """Look at N boxes that the channel judged; `name_of` takes their rows."""
        rows = np.flatnonzero(kept != visible)
        pixels = _wrong_pixels(evidence.take(rows), kept[rows])
        # Of equal ones the first come first, whoever counts.
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
    """One channel's rights and wrongs so far.

    Attributes
    ----------
    by_class, by_band : dict of Confusion
    judged : int
        Boxes that the channel had a number for; the segmentation judged the others.
    worst : Worst
        What to look at first.
    """

    by_class: dict[str, Confusion] = field(default_factory=dict)
    by_band: dict[str, Confusion] = field(default_factory=dict)
    judged: int = 0
    worst: Worst = field(default_factory=Worst)

    @property
    def total(self) -> Confusion:
        """All boxes together."""
        return sum(self.by_band.values(), start=Confusion())

    def as_dict(self) -> dict[str, Any]:
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
        """Add what happened in each group; `group` (N,) points into `names`."""
        code = group * 4 + self.kept * 2 + self.visible
        counts = np.bincount(code, minlength=4 * len(names)).reshape(-1, 4).tolist()
        for name, (hidden, lost, ghosts, found) in zip(names, counts, strict=True):
            if hidden + lost + ghosts + found:
                counted = Confusion(found, ghosts, lost, hidden)
                into[name] = into.get(name, Confusion()) + counted


def truth_from_instances(evidence: Evidence) -> tuple[IntArray, BoolArray]:
    """Which of N boxes had an instance image, and whether their objects are visible.

    Returns
    -------
    rows : (M,) int64
        Boxes whose instance was looked for.
    visible : (M,) bool
        Whether at least one pixel of it was there.
    """
    channels = evidence.channels
    if channels is None:
        return np.empty(0, np.int64), np.empty(0, np.bool_)
    rows = np.flatnonzero(channels.instance_pixels != NOT_MEASURED)
    return rows, channels.instance_pixels[rows] > 0
