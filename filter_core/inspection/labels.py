"""All labels of a recording, read once: what they hold, and which files they use.

Pictures are not read, except for the sizes of those whose labels do not tell them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from collections.abc import Set as AbstractSet
from contextlib import suppress
from pathlib import Path
from typing import Final, Generic, TypeVar

import numpy as np

from filter_core.annotation.frame import BoxAnnotation, FrameAnnotation
from filter_core.annotation.parsing import parse_annotation
from filter_core.annotation.units import check_units
from filter_core.arrays import BoolArray, FloatArray
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.reading import FrameSet, FrameSource, frame_size, missing_image
from filter_core.geometry.boxes import FORMS, to_xyxy
from filter_core.inspection.files import FileUse
from filter_core.inspection.listing import Listing
from filter_core.pipeline import box_class

_Thing = TypeVar("_Thing")

_BEYOND: Final = 0.01
"""Share of the image's side by which a box reaches out of it, at least, to be noted."""

_MOST_CLASSES: Final = 24
"""Classes of which a frame is looked at, also if they are rare."""


class Spread(Generic[_Thing]):
    """Some of many things, evenly spread, though it is not known how many come."""

    def __init__(self, most: int) -> None:
        self._most = max(1, most)
        self._step = 1
        self._seen = 0
        self._kept: list[_Thing] = []

    def add(self, thing: _Thing) -> None:
        """One more thing."""
        if self._seen % self._step == 0:
            self._kept.append(thing)
        if len(self._kept) > 2 * self._most:
            self._kept = self._kept[::2]
            self._step *= 2
        self._seen += 1

    @property
    def things(self) -> list[_Thing]:
        """As many as are asked for, in their order."""
        count = min(self._most, len(self._kept))
        return [self._kept[at * len(self._kept) // count] for at in range(count)]


class LabelSurvey:
    """What the labels of a recording hold.

    Attributes
    ----------
    boxes_3d : int
        Those that are given by a 3D box.
    roles : Counter of str
        How many frames have a file of each role.
    examples : dict of str to str
        The first file of each role.
    refused : Listing
        Frames that cannot be used, by the code of the first fault.
    faults : Listing
        Boxes that can hardly be right: ``outside`` of the image; ``beyond`` it in part;
        ``inverted``; ``empty``, without extent.
    use : FileUse
        The files of the frames.
    pictures : int
        How many frames are to be looked at.
    absent : set of str
        Paths of images whose content is not here.
    """

    def __init__(self, use: FileUse, pictures: int, absent: AbstractSet[str]) -> None:
        self.use, self.pictures, self.absent = use, pictures, absent
        self.frames = self.boxes = self.boxes_3d = 0
        self.by_class: Counter[str] = Counter()
        self.roles: Counter[str] = Counter()
        self.examples: dict[str, str] = {}
        self.refused, self.faults = Listing(), Listing()
        self._with_boxes: Spread[tuple[int, FrameSource]] = Spread(pictures)
        self._empty: Spread[tuple[int, FrameSource]] = Spread(pictures)
        self._of_class: dict[str, tuple[int, FrameSource]] = {}

    def read(
        self, frames: FrameSet, progress: Callable[[int, int | None], None]
    ) -> None:
        """Read all frames; a bad one is listed."""
        for frame in frames:
            self._add(frame)
            self.frames += 1
            progress(self.frames, frames.count)

    def sample(self) -> list[FrameSource]:
        """Frames whose pictures are to be looked at: spread, and of each class one."""
        if not self.pictures:
            return []
        chosen = dict(self._with_boxes.things)
        for at, frame in self._empty.things:
            if len(chosen) < self.pictures:
                chosen.setdefault(at, frame)
        chosen |= dict(self._of_class.values())
        return [chosen[at] for at in sorted(chosen)]

    def _add(self, frame: FrameSource) -> None:
        self.use.add(frame)
        files: dict[str, Path | None] = {
            "image": frame.image,
            "segmentation": frame.segmentation,
            **frame.others,
        }
        for role, path in files.items():
            if path is not None:
                self.roles[role] += 1
                self.examples.setdefault(role, self.use.relative(path) or str(path))
        try:
            if (
                problem := frame.problem
                or missing_image(frame)
                or self._empty_file(frame)
            ):
                raise problem
            annotation = parse_annotation(frame.annotation or {}, frame=frame.key)
            self._check(frame, annotation)
        except FilterError as problem:
            self.refused.refuse(frame.key, problem)
            return
        names = [box_class(box) for box in annotation.boxes]
        self.by_class.update(names)
        self.boxes += len(names)
        if self.absent and not self.absent.isdisjoint(map(str, files.values())):
            return
        place = (self.frames, frame)
        (self._with_boxes if names else self._empty).add(place)
        for name in names:
            if len(self._of_class) < _MOST_CLASSES:
                self._of_class.setdefault(name, place)

    def _empty_file(self, frame: FrameSource) -> LayoutError | None:
        """The error about a picture of 0 bytes, unless its content is elsewhere."""
        path = frame.image
        if path is None or str(path) in self.absent:
            return None
        with suppress(OSError):  # said when it is used
            if path.stat().st_size == 0:
                return LayoutError(f"{path.name} has 0 bytes", code="empty_file")
        return None

    def _check(self, frame: FrameSource, annotation: FrameAnnotation) -> None:
        """Note rectangles that can hardly be right."""
        by_form: dict[str, list[BoxAnnotation]] = {}
        for box in annotation.boxes:
            by_form.setdefault(box.form, []).append(box)
        for form, boxes in by_form.items():
            if form not in FORMS:
                self.boxes_3d += len(boxes)
                continue
            values = np.array([box.values for box in boxes], np.float64)
            is_share = form.endswith("n")
            last = values[:, 2:] - (values[:, :2] if form.startswith("xyxy") else 0)
            is_inverted = np.asarray((last < 0).any(axis=1), np.bool_)
            wh = annotation.camera_wh or (1, 1)
            if annotation.camera_wh is None and (not is_share or is_inverted.any()):
                size = frame_size(frame)
                if size is None:  # said when the frame is measured
                    continue
                wh = size
            self._note(frame.key, boxes, to_xyxy(form, values, wh), wh)
            check_units(annotation, wh, "paper", frame.key)

    def _note(
        self,
        key: str,
        boxes: list[BoxAnnotation],
        xyxy: FloatArray,
        wh: tuple[int, int],
    ) -> None:
        first, last = xyxy[:, :2], xyxy[:, 2:]
        if (first >= 0).all() and (last <= wh).all() and (last > first).all():
            return  # as in nearly all frames
        for kind, applies in _faults(xyxy, wh):
            for row in np.flatnonzero(applies).tolist():
                box = boxes[row]
                numbers = ", ".join(f"{number:.6g}" for number in box.values)
                self.faults.add(
                    kind, key, f"{box_class(box)} {box.id}: {box.form} [{numbers}]"
                )


def _faults(xyxy: FloatArray, wh: tuple[int, int]) -> Iterator[tuple[str, BoolArray]]:
    """The kinds of faults, each with the rectangles in px that have it."""
    first, last, size = xyxy[:, :2], xyxy[:, 2:], np.array(wh, np.float64)
    is_inverted = (last < first).any(axis=1)
    is_outside = ((first >= size) | (last <= 0)).any(axis=1)
    reaches_out = ((first < -_BEYOND * size) | (last > (1 + _BEYOND) * size)).any(
        axis=1
    )
    is_empty = (last == first).any(axis=1)
    yield "outside", np.asarray(is_outside & ~is_inverted, np.bool_)
    yield "beyond", np.asarray(reaches_out & ~is_outside & ~is_inverted, np.bool_)
    yield "inverted", np.asarray(is_inverted, np.bool_)
    yield "empty", np.asarray(is_empty & ~is_inverted, np.bool_)
