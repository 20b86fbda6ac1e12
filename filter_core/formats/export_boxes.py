"""Which boxes of a frame go out, with which rectangle, clipped to the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from filter_core.formats.export import ExportBox, ExportFrame, Rectangle
from filter_core.formats.export_options import ExportOptions
from filter_core.formats.tally import ExportTally

_RECTANGLES: Final = {
    "visible": ("xyxy",),
    "amodal": ("amodal_xyxy", "xyxy"),
    "tight": ("tight_xyxy", "visible_xyxy", "xyxy"),
}
"""The keys of a decision in which a rectangle is looked for."""

_NOWHERE: Final = (0.0, 0.0, 0.0, 0.0)

_LEAST_SIDE: Final = 0.01
"""Pixels; what is thinner would vanish when a format rounds it."""


@dataclass(frozen=True)
class OutBox:
    """One box as it is written.

    Attributes
    ----------
    box : ExportBox
    number : int
        The place of its class in the frozen list.
    xyxy : (4,) px
        Inside the image.
    cut : float
        Share of the rectangle that lies beyond the image, 0..1.
    ignored : bool
        A region that training and scoring are to ignore, and no object.
    """

    box: ExportBox
    number: int
    xyxy: tuple[float, float, float, float]
    cut: float = 0.0
    ignored: bool = False

    @property
    def is_cut(self) -> bool:
        """Whether the image's border goes through it."""
        return self.cut > 0


@dataclass(frozen=True)
class Traits:
    """What sets a format apart from others.

    Attributes
    ----------
    name : str
    crowds : bool
        It can say that a box stands for many objects at once. In other formats a crowd
        is no object to learn from, and is left out.
    unplaced : bool
        It can hold a box without a rectangle in the image.
    keys : bool
        Its files do not tell the keys of frames: ``frames.jsonl`` does.
    flat : bool
        Its readers do not look into sub-folders.
    """

    name: str
    crowds: bool = False
    unplaced: bool = False
    keys: bool = False
    flat: bool = False


class BoxChooser:
    """Chooses the boxes of each frame and keeps the books on all of them.

    Parameters
    ----------
    classes : sequence of str
        In their frozen order.
    options : ExportOptions
    tally : ExportTally
    traits : Traits
        Of the format.
    """

    def __init__(
        self,
        classes: Sequence[str],
        options: ExportOptions,
        tally: ExportTally,
        traits: Traits,
    ) -> None:
        self._number = {name: index for index, name in enumerate(classes)}
        self._options = options
        self._tally = tally
        self._traits = traits

    def choose(self, frame: ExportFrame) -> list[OutBox]:
        """The boxes of one frame that are written, in the order they came."""
        chosen = (self._choose(frame, box) for box in frame.boxes)
        return [one for one in chosen if one is not None]

    def _choose(self, frame: ExportFrame, box: ExportBox) -> OutBox | None:
        self._tally.box(box)
        reason, ignorable = self._reason_to_drop(box)
        key, xyxy = self._rectangle(box)
        inside = clipped(xyxy or _NOWHERE, frame.wh)
        if reason is None and not (_has_extent(inside) or self._traits.unplaced):
            reason = str(box.decision["reason"]) if xyxy is None else "degenerate"
            ignorable = False
        if reason is not None and not (
            ignorable and self._options.rejected == "dontcare" and _has_extent(inside)
        ):
            self._tally.dropped(frame, box, reason)
            return None
        out = OutBox(
            box=box,
            number=self._number[box.class_name],
            xyxy=inside,
            cut=_cut(box, xyxy or _NOWHERE, frame.wh),
            ignored=reason is not None,
        )
        if reason is not None:
            self._tally.dont_care(frame, box, reason)
        else:
            self._tally.written(frame, box, clipped=out.is_cut, rectangle=key)
        return out

    def _rectangle(self, box: ExportBox) -> tuple[str, Rectangle | None]:
        for key in _RECTANGLES[self._options.boxes]:
            xyxy = box.rectangle(key)
            if xyxy is not None:
                used = "visible" if key == "xyxy" else key.removesuffix("_xyxy")
                return used, xyxy
        return "", None

    def _reason_to_drop(self, box: ExportBox) -> tuple[str | None, bool]:
        """Why a box is no object of the export, and whether it is one to ignore."""
        if box.is_crowd and not self._traits.crowds:
            return "crowd", True
        include = self._options.include
        if include == "all":
            return None, False
        verdict = box.verdict if include == "effective" else box.decision["verdict"]
        if verdict == "kept":
            return None, False
        if verdict == "unmeasured" and self._options.include_unmeasured:
            return None, False
        by_person = include == "effective" and box.is_reviewed
        reason = "rejected_by_person" if by_person else str(box.decision["reason"])
        return reason, verdict == "rejected"


def clipped(xyxy: Rectangle, wh: tuple[int, int]) -> tuple[float, float, float, float]:
    """A rectangle cut to the image; a side may be left without extent."""
    width, height = wh
    x_min, x_max = (min(max(float(xyxy[i]), 0.0), float(width)) for i in (0, 2))
    y_min, y_max = (min(max(float(xyxy[i]), 0.0), float(height)) for i in (1, 3))
    return x_min, y_min, x_max, y_max


def _cut(box: ExportBox, xyxy: Rectangle, wh: tuple[int, int]) -> float:
    """Share of the whole rectangle beyond the image; above 0 if anything is."""
    whole = box.rectangle("amodal_xyxy") or box.given_xyxy or xyxy
    inside = clipped(whole, wh)
    if list(inside) == list(whole):
        return 0.0
    area = _area(whole)
    left = _area(inside) / area if area > 0 else 0.0
    return min(max(1.0 - left, 1e-9), 1.0)


def _has_extent(xyxy: Rectangle) -> bool:
    return min(xyxy[2] - xyxy[0], xyxy[3] - xyxy[1]) >= _LEAST_SIDE


def _area(xyxy: Rectangle) -> float:
    return float(max(xyxy[2] - xyxy[0], 0.0) * max(xyxy[3] - xyxy[1], 0.0))
