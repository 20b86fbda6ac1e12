"""The labels of a recording as its description says: unit, notation, names, map.

A format fixes how a rectangle is written, and people write others into it: percent into
COCO's ``bbox``, corners into YOLO's columns. Each of these would be the rectangle of
other pixels, and mostly of none of the object's. One frame seldom shows it; many do.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from filter_core.annotation.parsing import parse_annotation
from filter_core.annotation.units import MAX_SHARE, PERCENT, unit_of_shares
from filter_core.arrays import BoolArray, FloatArray
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.reading import KEYS_NAME, FrameSet, FrameSource, frame_size
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.words import map_in
from filter_core.geometry.boxes import FORMS, to_xyxy

_SAMPLE: Final = 200
"""Frames whose labels are looked at, the first of a recording."""

_FEWEST: Final = 3
"""Different rectangles that can show a unit or a notation together."""

_FEWEST_WHOLE: Final = 20
"""Boxes that can show percent if all are whole numbers, or no size of images is known.

So many do not lie in the first hundred rows and columns by chance.
"""

_LEAST_SIDES: Final = {False: 300, True: 150}
"""px, for few and for many boxes; in smaller images, boxes in pixels are often within
the first hundred."""

_OUTSIDE: Final = 1 / 3
"""Share of boxes that reach out of the image in the wrong notation, at least."""

_SCALE: Final = {"pixels": 1.0, "shares": 1.0, "percent": 1 / PERCENT}


def described_labels(
    frames: FrameSet, description: RecordingDescription, *, recognise: bool
) -> FrameSet:
    """The frames with their boxes as the description says.

    Where it does not say the unit or the corners, they are those of the format. With
    `recognise`, a recording that `other_notations` recognises is refused. Raises
    `LayoutError` (``wrong_unit``, ``wrong_corners``): the boxes together look like
    those of another unit or notation than the format's, and the description does not
    say it.
    """
    if recognise:
        for _, _, error in other_notations(frames, description):
            raise error
    names = description.class_names
    if not names and description.unit == description.corners == "auto":
        return frames

    def described() -> Iterator[FrameSource]:
        for frame in frames.frames():
            if frame.annotation is None:
                yield frame
            else:
                annotation = _described(frame.annotation, description)
                yield replace(frame, annotation=annotation)

    classes = frames.classes
    if classes is not None:
        classes = tuple(dict.fromkeys(names.get(name, name) for name in classes))
    return replace(frames, frames=described, classes=classes)


def _described(
    annotation: Mapping[str, object], description: RecordingDescription
) -> dict[str, object]:
    boxes = annotation.get("boxes")
    if not isinstance(boxes, list | tuple):
        return dict(annotation)
    names = description.class_names
    described: list[object] = []
    for box in boxes:
        if not isinstance(box, Mapping):
            described.append(box)
            continue
        items = (_rectangle(key, value, description) for key, value in box.items())
        own = dict(items)
        name = own.get("class")
        if isinstance(name, str):
            own["class"] = names.get(name, name)
        described.append(own)
    return {**annotation, "boxes": described}


def _rectangle(
    form: str, values: object, description: RecordingDescription
) -> tuple[str, object]:
    """The key and the numbers of a rectangle; other keys of a box as they are."""
    if form not in FORMS:
        return form, values
    try:
        numbers = np.array(values, np.float64)
    except (TypeError, ValueError):
        return form, values
    if numbers.shape != (4,):
        return form, values
    unit = "shares" if form.endswith("n") else "pixels"
    unit = unit if description.unit == "auto" else description.unit
    corners = form.removesuffix("n")
    corners = corners if description.corners == "auto" else description.corners
    numbers = numbers * _SCALE[unit]
    if corners == "inclusive":
        corners, numbers = "xyxy", np.add(numbers, (0, 0, 1, 1))
    if unit == "pixels":
        return corners, numbers.tolist()
    if corners == "xywh":
        corners, (numbers,) = "xyxy", to_xyxy("xywh", [numbers], (1, 1))
    return f"{corners}n", numbers.tolist()


def with_maps(
    frames: FrameSet, description: RecordingDescription, source: Path
) -> FrameSet:
    """The frames with the maps that the description, or else their paths, say.

    Parameters
    ----------
    frames : FrameSet
        What a path says counts only for frames whose annotations name no map; a note
        says which.
    source : Path
        Its name, and those of folders and files below, may be those of maps. Not
        looked at if a manifest or the list in an export names the maps.
    """
    root = source if source.is_dir() else source.parent
    is_said = frames.layout == "manifest" or (root / KEYS_NAME).is_file()
    if description.map == "none" or (description.map == "auto" and is_said):
        return frames
    named = None if description.map == "auto" else description.map
    told: Counter[str] = Counter()

    def mapped() -> Iterator[FrameSource]:
        told.clear()
        for frame in frames.frames():
            annotation = frame.annotation
            name = named
            if annotation is not None and named is None and "map" not in annotation:
                path = frame.image or frame.segmentation
                path = path or frame.others.get("instances") or Path()
                below = str(path).removeprefix(str(root.parent))
                name = map_in(below) or map_in(frame.key)
                told.update([name] if name else [])
            if annotation is not None and name is not None:
                frame = replace(frame, annotation={**annotation, "map": name})
            yield frame

    def notes() -> tuple[str, ...]:
        counts = (f"{name} ({count})" for name, count in sorted(told.items()))
        words = "maps of frames by names of folders and files"
        return (*frames.notes(), *([f"{words}: {', '.join(counts)}"] if told else []))

    return replace(frames, frames=mapped, notes=notes)


def other_notations(
    frames: FrameSet, description: RecordingDescription
) -> Iterator[tuple[str, str, LayoutError]]:
    """What the boxes of the first frames look like together, if not as expected.

    The key of a description that says it, ``unit`` or ``corners``; what they look like,
    several words with "or" if that is not clear; and the error about it.

    Parameters
    ----------
    frames : FrameSet
        Their boxes as the format has them.
    description : RecordingDescription
        What it says is not looked for. In the unit that it says, boxes may show
        another notation.
    """
    if "auto" not in (description.unit, description.corners):
        return
    for form, rows in _sampled(frames).items():
        values = np.array([row for row, _ in rows], np.float64)
        if len(np.unique(values, axis=0)) < _FEWEST:
            continue
        sizes = _Sizes([frame for _, frame in rows])
        described, scale = form, 1.0
        if description.unit != "auto":
            is_share = description.unit != "pixels"
            described = form.removesuffix("n") + "n" * is_share
            scale = _SCALE[description.unit]
        others = {
            "unit": _other_unit(form, values, sizes),
            "corners": _other_corners(described, scale * values, sizes),
        }
        for key, word in others.items():
            if word is not None and getattr(description, key) == "auto":
                yield key, word, _error(frames, form, values, key, word)


def _sampled(
    frames: FrameSet,
) -> Mapping[str, list[tuple[tuple[float, ...], FrameSource]]]:
    """The numbers of rectangles by their form, each with its frame."""
    by_form: dict[str, list[tuple[tuple[float, ...], FrameSource]]] = defaultdict(list)
    with suppress(OSError):  # reported when the frames are used, as all faults are
        for frame in islice(frames.frames(), _SAMPLE):
            with suppress(FilterError):
                annotation = frame.annotation or {}
                for box in parse_annotation(annotation, frame=frame.key).boxes:
                    if box.form in FORMS:
                        by_form[box.form].append((box.values, frame))
    return by_form


class _Sizes:
    """The sizes of the images of boxes, which are read if they are needed."""

    def __init__(self, frames: list[FrameSource]) -> None:
        self._frames = frames

    @cached_property
    def wh(self) -> FloatArray:
        """(N, 2) px: width and height of the image of each box; NaN: unknown."""
        by_key = {frame.key: frame for frame in self._frames}
        size_by_key = {
            key: frame_size(frame) or (np.nan, np.nan) for key, frame in by_key.items()
        }
        return np.array([size_by_key[frame.key] for frame in self._frames], np.float64)

    @property
    def is_known(self) -> BoolArray:
        """(N,): the images of which the size is known."""
        return np.asarray(~np.isnan(self.wh).any(axis=1), np.bool_)


def _other_unit(form: str, values: FloatArray, sizes: _Sizes) -> str | None:
    """The unit that the numbers of all boxes of a form have, if not the form's own."""
    if form.endswith("n"):
        is_large = (np.abs(values) > MAX_SHARE).any(axis=1)
        return unit_of_shares(values) if 2 * is_large.sum() > len(values) else None
    if values.min() < 0 or values.max() > PERCENT:
        return None
    is_whole = bool((values == np.rint(values)).all())
    if values.max() <= 1:
        return None if is_whole else "shares"
    are_many = len(values) >= _FEWEST_WHOLE
    if is_whole and not are_many:
        return None
    wh = sizes.wh[sizes.is_known]
    is_percent = are_many
    if wh.size:
        is_percent = bool(wh.min() >= _LEAST_SIDES[are_many])
    return "percent" if is_percent else None


def _other_corners(form: str, values: FloatArray, sizes: _Sizes) -> str | None:
    """The notation that the boxes of a form seem to have, if it is not the form's.

    By the share of boxes with inverted corners, or that reach out of the image.
    """
    first, last = values[:, :2], values[:, 2:]
    if form.startswith("xyxy"):
        is_inverted = (last < first).any(axis=1)
        # If all are inverted, corners may be exchanged, and each frame is refused.
        is_size = len(values) < 2 * is_inverted.sum() < 2 * len(values)
        return "xywh" if is_size else None
    if (last < first).any():
        return None
    wh = np.ones((1, 2))
    if not form.endswith("n"):
        values, wh = values[sizes.is_known], sizes.wh[sizes.is_known]
        if len(np.unique(values, axis=0)) < _FEWEST:
            return None
        first, last = values[:, :2], values[:, 2:]
    margin = wh / 100
    xyxy = to_xyxy(form.removesuffix("n"), values, (1, 1))
    reaches_out = (xyxy[:, :2] < -margin) | (xyxy[:, 2:] > wh + margin)
    fits = ((first >= -margin) & (last <= wh + margin)).all()
    return "xyxy" if fits and reaches_out.any(axis=1).mean() >= _OUTSIDE else None


def _error(
    frames: FrameSet, form: str, values: FloatArray, key: str, word: str
) -> LayoutError:
    """The error about boxes that look like those of another unit or notation."""
    example = ", ".join(f"{number:.6g}" for number in values[len(values) // 2])
    words = word.split(" or ")
    own = {"unit": "shares" if form.endswith("n") else "pixels"}
    own["corners"] = form.removesuffix("n")
    remedies = [f"`boxes: {{{key}: {each}}}`" for each in dict.fromkeys(words)]
    return LayoutError(
        f"the boxes look like {_MEANINGS[word]}, and layout {frames.layout} expects "
        f"{_MEANINGS[own[key]]}: {len(values)} boxes were looked at together, such as "
        f"[{example}]; {' or '.join(remedies)} or "
        f"`boxes: {{{key}: {own[key]}}}` in recording.yaml says which it is",
        code=f"wrong_{key}",
    )


_MEANINGS: Final = {
    "pixels": "pixels",
    "shares": "shares of the image's width and height",
    "percent": "percent of the image's width and height",
    "pixels or percent": "pixels or percent of the image's width and height",
    "xyxy": "the first and the last corner (xyxy)",
    "inclusive": "the first corner and the last pixel (inclusive)",
    "xywh": "the first corner, width and height (xywh)",
    "cxcywh": "the centre, width and height (cxcywh)",
}
