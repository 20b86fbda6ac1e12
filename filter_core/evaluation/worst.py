"""The boxes that a channel got wrong most visibly: what to look at first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np

from filter_core.types import BoolArray, Evidence, IntArray

MOST: Final = 20

NameOf: TypeAlias = Callable[[int], Mapping[str, Any]]
"""What a box is called, by its row; asked only of those that are listed."""


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
