"""YOLO as Ultralytics has it: images, a text file of boxes for each, a class list.

Images and labels may lie in parallel folders, in any nesting, or in one folder. Lines
with four columns, raw centres in pixels as in carlasimu's sample, are read as well, and
so are polygons and rotated boxes, as the rectangles around them.

References
----------
.. [1] Ultralytics, "Object detection datasets overview",
   https://docs.ultralytics.com/datasets/detect/, also .../segment/, .../obb/, .../pose/
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from typing import BinaryIO, ClassVar, Final

import numpy as np
import yaml

from filter_core.config.file import parse_yaml
from filter_core.errors import ConfigError, LayoutError
from filter_core.formats.format import (
    FOLDER_OPTIONS,
    LABEL_NEEDS,
    LABEL_OPTIONS,
    Format,
    Recognition,
    Source,
)
from filter_core.formats.matching import FrameFileNames, frame_of, match, with_keys
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    FrameSet,
    FrameSource,
    Unmatched,
    annotated,
    band_folders,
    has_rows,
    is_label,
    is_number,
    key_of_folders,
    missing_image,
    read_columns,
    read_label_text,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.same import (
    BESIDE,
    BoxSpan,
    OwnLabels,
    OwnReading,
    Rectangles,
    joined_beside,
    spans_of_lines,
    stored_labels,
)
from filter_core.formats.splits import completed_parts, role_of_part
from filter_core.formats.streams import Streams
from filter_core.formats.words import TEXT_LISTS, YAML_LISTS, holds_boxes
from filter_core.formats.writing import ExportContext, LabelBoxes, OutFrame, Traits

YOLO: Final = Format(
    name="yolo",
    title="YOLO (Ultralytics)",
    docs_row=(
        "`class cx cy w h` as shares of the image's size, a label file for each "
        "image (an empty one for an empty frame); `images/train/`, `images/val/`, "
        "and `data.yaml` with `train`, `val` and `names`, as Ultralytics reads them"
    ),
    brief="images, labels and data.yaml",
    recognised_by="YOLO's labels with data.yaml or classes.txt",
    read_options=FOLDER_OPTIONS | {"classes", "default_class"},
    needs=LABEL_NEEDS,
    numbers_classes=True,
    options=LABEL_OPTIONS | {"bands"},
)


@YOLO.recogniser
def _recognise(source: Source) -> Recognition:
    label = _first_label(source)
    return "possible" if label and _class_list(source.path) else "none"


class NoClassList(LayoutError):
    """A folder with labels of YOLO, but without the list of their classes."""


def _first_label(source: Source) -> str | None:
    texts = (name for name in source.label_files if name.lower().endswith(".txt"))
    return next((name for name in texts if is_label(source.path, name)), None)


def lacking_class_list(source: Source) -> str:
    """What a folder lacks that has labels, but no list of classes; empty if neither."""
    label = _first_label(source)
    if label is None or _class_list(source.path):
        return ""
    *first, last = (*YAML_LISTS, *TEXT_LISTS)
    return (
        f"found {label}, which may be a label of YOLO, but no list of its "
        f"classes in {', '.join(first)} or {last}"
    )


def _class_list(root: Path) -> str | None:
    """The folder's file that lists classes, relative to it, if there is one.

    Some tools put it among the labels.
    """
    names = (*YAML_LISTS, *TEXT_LISTS)
    places = (*names, *(f"labels/{name}" for name in names))
    return next((name for name in places if (root / name).is_file()), None)


@YOLO.reader
def read_yolo(root: Path, options: RecordingDescription) -> FrameSet:
    """The frames of a YOLO folder; a bad file is its frame's problem.

    Raises `LayoutError`: there is no list of classes, or it cannot be read.
    """
    listed, keypoint_columns, beside = _described(root)
    classes = tuple(options.classes or listed)
    if not classes:
        raise NoClassList(
            f"expected the class names in one of {', '.join(YAML_LISTS)} or "
            f"{', '.join(TEXT_LISTS)}, found none of them"
        )
    skip = band_folders(root)
    folders = LabelFolders(
        images=root,
        labels=options.labels or root,
        classes=classes,
        default_class=options.default_class,
        keypoint_columns=keypoint_columns,
        beside=beside,
    )
    labels = (
        name
        for name in options.files.walk(root, folders.labels, (".txt",), skip)
        if holds_boxes(name)
    )
    return frame_set("yolo", folders, Streams(root, options, skip=skip), labels)


_COMPOSED: Final = ("path", "train", "val", "valid", "validation", "test", "names")
"""Keys of ``data.yaml`` that say where an export's files are, and its classes."""


def _is_json(value: object) -> bool:
    """Whether a value of YAML is written in JSON as it is; a date is not."""
    try:
        return bool(json.loads(json.dumps(value, allow_nan=False)) == value)
    except (TypeError, ValueError):
        return False


def _described(root: Path) -> tuple[tuple[str, ...], int | None, dict[str, object]]:
    """What ``data.yaml`` says, or a text file with one name per line.

    The classes, none if there is no list; `LabelFolders.keypoint_columns`; and the
    other keys of ``data.yaml`` with values that JSON has.
    """
    name = _class_list(root)
    if name is None:
        return (), None, {}
    text = read_label_text(root / name, name)
    if name.endswith(TEXT_LISTS):
        lines = map(str.strip, text.splitlines())
        return tuple(filter(None, lines)), None, {}
    try:
        document = parse_yaml(text)
    except ConfigError as exc:
        raise LayoutError(f"{name}: {exc.detail}") from exc
    entries = document if isinstance(document, Mapping) else {}
    shape = entries.get("kpt_shape")
    columns = None
    if isinstance(shape, list) and [type(number) for number in shape] == [int, int]:
        columns = max(shape[0] * shape[1], 0)
    beside = {
        key: value
        for key, value in entries.items()
        if key not in _COMPOSED and isinstance(key, str) and _is_json(value)
    }
    return ordered_names(entries.get("names"), f"{name}, names"), columns, beside


def ordered_names(names: object, at: str) -> tuple[str, ...]:
    """Names in the order of their numbers, which must be 0, 1, 2 and so on.

    `names` is a list, or a mapping from number to name; `at` is its place, for errors.
    Raises `LayoutError`: it is neither, it is empty, numbers are left out, or a name is
    no text.
    """
    if isinstance(names, Mapping):
        numbered = list(names.items())
        keys = [key for key, _ in numbered]
        if any(not isinstance(key, int) for key in keys) or sorted(keys) != list(
            range(len(keys))
        ):
            raise LayoutError(f"{at}: expected numbers from 0 up, found {keys[:8]}")
        names = [word for _, word in sorted(numbered)]
    if not isinstance(names, Sequence) or isinstance(names, str) or not names:
        raise LayoutError(f"{at}: expected a list of class names")
    for word in names:
        if not isinstance(word, str) or not word:
            raise LayoutError(f"{at}: expected a class name, found {str(word)[:40]!r}")
    return tuple(names)


@dataclass(frozen=True)
class LabelFolders:
    """The folders and the classes of a YOLO-like layout.

    Attributes
    ----------
    images, labels : Path
        Folders.
    classes : tuple of str
        Class names by their numbers.
    default_class : str
        The class of labels that carry none.
    keypoint_columns : int or None
        How many columns follow each rectangle, for the points of a pose; None if
        nothing says it.
    beside : mapping
        What the list of classes says else.
    export : Path or None
        The top folder of an export, with its list of keys; default: `images`.
    """

    images: Path
    labels: Path
    classes: tuple[str, ...]
    default_class: str = "unknown"
    keypoint_columns: int | None = None
    beside: Mapping[str, object] = field(default_factory=dict)
    export: Path | None = None


def frame_set(
    layout: str, folders: LabelFolders, streams: Streams, labels: Iterator[str]
) -> FrameSet:
    """Frames of label files in YOLO's or carlasimu's form.

    `labels` are text files, relative to the folder of the labels. One that no image is
    called like is a label only if it looks like one (`has_rows`); among labels it is
    listed unless it is a note or a list (`_may_be_damaged`).
    """
    matched, unmatched = match(labels, streams.images)
    no_labels = []

    def with_labels() -> Iterator[FrameFileNames]:
        for frame in matched:
            if frame.image or has_rows(folders.labels / frame.label):
                yield frame
            elif _may_be_damaged(frame.label, folders):
                no_labels.append(Unmatched(frame.label, _NO_LABEL))

    frames, left_over = streams.complete(with_labels(), "label file")
    top = folders.export or folders.images
    below = key_of_folders(folders.images.relative_to(top).as_posix())
    named = with_keys(top, frames, below)
    outlines = _Outlines(folders, named)
    notes = streams.notes

    def read() -> Iterator[FrameSource]:
        outlines.counts.clear()
        beside: Mapping[str, object] | None = folders.beside
        for file_names in named:
            annotation = partial(_annotation, folders, file_names, outlines)
            frame = frame_of(file_names, folders.images, folders.labels)
            frame = annotated(frame, annotation)
            if beside and frame.origin and not (frame.problem or missing_image(frame)):
                origin = frame.origin._replace(beside=beside)
                frame, beside = replace(frame, origin=origin), None
            yield frame

    return FrameSet(
        layout=layout,
        frames=read,
        classes=folders.classes,
        count=len(frames),
        unmatched=(*unmatched, *no_labels, *left_over),
        notes=lambda: (*notes, *outlines.notes()),
        streams=streams.facts,
        texts=lambda: chain(
            (folders.labels / frame.label for frame in named),
            (root / name for root in [folders.images] if (name := _class_list(root))),
        ),
    )


_NO_LABEL: Final = (
    "it has no image, and its first line is no label: expected 'class cx cy w h', "
    "separated by spaces"
)

_NOTES: Final = ("readme", "license", "licence", "notes", "changelog", "citation")

_LABEL_FOLDERS: Final = frozenset({"labels", "label"})

_MOST_SHOWN: Final = 4096
"""Characters of a text by which a list of names is told."""


def _may_be_damaged(label: str, folders: LabelFolders) -> bool:
    """Whether a text without an image that does not look like a label may be one.

    It is among the labels, its name is not that of notes, and it is no list: of names
    or paths, one a line, without a separate number and without separators.
    """
    *above, last = label.lower().split("/")
    is_among_labels = folders.labels != folders.images or _LABEL_FOLDERS & {*above}
    if not is_among_labels or last.startswith(_NOTES):
        return False
    try:
        text = read_label_text(folders.labels / label, label)[:_MOST_SHOWN]
    except LayoutError:
        return True
    return any(
        set(",;|\t") & {*line} or any(map(is_number, line.split()))
        for line in text.splitlines()
        if not line.lower().endswith(IMAGE_SUFFIXES)
    )


_MOST_LINES: Final = 512
"""Longer lines that are looked at to tell whether they are outlines."""

_FEW_CORNERS: Final = 0.1
"""Share of rectangles, at most, that lie partly beyond the image in poses."""


class _Outlines:
    """The lines of a recording that may be outlines: polygons or rotated boxes.

    `counts` says how many were read, by label file.
    """

    def __init__(self, folders: LabelFolders, frames: Iterable[FrameFileNames]) -> None:
        self.counts: Counter[str] = Counter()
        self._folders = folders
        self._frames = frames

    @cached_property
    def are_certain(self) -> bool:
        """Whether longer lines are outlines, not rectangles with something behind.

        Those of a pose or a tracker all have as many columns, and begin with a
        rectangle in the image; outlines differ in the number of their corners, or
        the first numbers of many are no such rectangle. A few hundred lines show it.
        """
        if self._folders.keypoint_columns is not None:
            return True
        seen: set[int] = set()
        lines = corners = 0
        for files in self._frames:
            label = files.label
            try:
                text = read_label_text(self._folders.labels / label, label)
                for columns in map(str.split, text.splitlines()):
                    if _is_outline(len(columns), self._folders):
                        seen.add(len(columns))
                        numbers = read_columns(columns[1:], label)
                        if len(seen) > 1:
                            return True
                        lines += 1
                        corners += not _may_be_rectangle(numbers)
            except LayoutError:
                continue  # its frame will have this problem
            if lines >= _MOST_LINES:
                break
        return corners > _FEW_CORNERS * lines

    def notes(self) -> Iterator[str]:
        """How many outlines were read."""
        if self.counts:
            yield (
                f"{self.counts.total()} outlines (polygons or rotated boxes) in "
                f"{len(self.counts)} label files were read as the rectangles around "
                "them"
            )


def _may_be_rectangle(numbers: Sequence[float]) -> bool:
    """Whether the columns behind a class may begin with a rectangle in the image.

    They do if some are no corners.
    """
    low, high = _SHARES
    if not all(low <= share <= high for share in numbers[: len(numbers) // 2 * 2]):
        return True
    centre, extent = numbers[:2], numbers[2:4]
    return all(
        side > 0 and middle - side / 2 >= -_BEYOND and middle + side / 2 <= 1 + _BEYOND
        for middle, side in zip(centre, extent, strict=True)
    )


def _annotation(
    folders: LabelFolders, files: FrameFileNames, outlines: _Outlines
) -> dict[str, object]:
    """The boxes of one label file; `outlines` counts those that are no rectangles.

    A line is ``class cx cy w h`` (shares of the image; a sixth column is kept as
    ``confidence``, and the points of a pose are passed over), a class and the corners
    of an outline (shares, ``x y`` for each, also with a confidence), or ``cx cy w h``
    in pixels without a class.
    """
    text = read_label_text(folders.labels / files.label, files.label)
    boxes = []
    for number, line in enumerate(text.splitlines(), start=1):
        columns = line.split()
        if columns:
            at = f"{files.label}, line {number}"
            boxes.append(_read_line(columns, at, folders))
            if _is_outline(len(columns), folders):
                if not outlines.are_certain:
                    raise LayoutError(
                        f"{at}: expected 'class cx cy w h' (5 columns), found "
                        f"{len(columns)} columns, which may be a rectangle with the "
                        "points of a pose or other numbers behind it, or an outline: "
                        f"all such lines of the recording are as long. {_REMEDY}"
                    )
                outlines.counts[files.label] += 1
    return {"boxes": boxes}


@YOLO.spans
def line_spans(file: BinaryIO) -> Iterator[BoxSpan]:
    """The lines of a label file that are not empty."""
    return spans_of_lines(file, bool)


_WITH_CONFIDENCE: Final = 6

RAW_COLUMNS: Final = 4

_LEAST_OUTLINE: Final = 7
"""A class and three corners."""

_BEYOND: Final = 0.01
"""How far a rectangle may lie beyond the image, as a share of it, by rounding."""

_SHARES: Final = (-0.5, 1.5)
"""Corners of outlines may lie beyond the image, but not far: a number behind a
rectangle, such as a track's, is no corner."""


_REMEDY: Final = (
    "Say in data.yaml how many points follow, and of how many numbers, as kpt_shape: "
    "[17, 3]; kpt_shape: [0, 2] says that the lines are outlines"
)


def _is_outline(columns: int, folders: LabelFolders) -> bool:
    pose = 5 + (folders.keypoint_columns or 0)
    return columns >= _LEAST_OUTLINE and columns not in (pose, pose + 1)


def _read_line(columns: list[str], at: str, folders: LabelFolders) -> dict[str, object]:
    count, points = len(columns), folders.keypoint_columns or 0
    if count == RAW_COLUMNS:
        return {"class": folders.default_class, "cxcywh": read_columns(columns, at)}
    if count < RAW_COLUMNS:
        raise LayoutError(
            f"{at}: expected 'class cx cy w h' (5 columns) or 'cx cy w h' in pixels "
            f"(4 columns), found {count} columns"
        )
    word, classes = columns[0], folders.classes
    is_number = word.isascii() and word.isdigit() and len(word) < 10
    if not is_number or int(word) >= len(classes):
        raise LayoutError(
            f"{at}: expected a class from 0 to {len(classes) - 1}, found {word[:40]!r}"
        )
    box: dict[str, object] = {"class": classes[int(word)]}
    numbers = read_columns(columns[1:], at)
    if _is_outline(count, folders):
        corners = len(numbers) // 2 * 2
        box["cxcywhn"] = _around(numbers[:corners], at)
        behind = numbers[corners:]
    else:
        box["cxcywhn"] = numbers[:4]
        behind = numbers[4:] if count == _WITH_CONFIDENCE else numbers[4 + points :]
    if behind:
        box["confidence"] = behind[0]
    return box


def _around(corners: Sequence[float], at: str) -> list[float]:
    """Centre and extent of the rectangle around corners, all as shares."""
    low, high = _SHARES
    for share in corners:
        if not low <= share <= high:
            raise LayoutError(
                f"{at}: expected shares of the image's size in these "
                f"{len(corners) + 1} columns, as a polygon has, found {share:g}. "
                f"{_REMEDY}"
            )
    axes = [(min(each), max(each)) for each in (corners[::2], corners[1::2])]
    return [
        *((first + last) / 2 for first, last in axes),
        *(last - first for first, last in axes),
    ]


def line_rectangles(own: OwnLabels) -> Iterator[Rectangles]:
    """Of each line what it may be: columns do not tell a pose from an outline."""
    for columns in filter(None, map(str.split, own.text.splitlines())):
        numbers = read_columns(columns, own.file)
        if len(numbers) == RAW_COLUMNS:
            yield {"cxcywh": [numbers]}
            continue
        corners = numbers[1 : 1 + (len(numbers) - 1) // 2 * 2]
        is_long = len(numbers) >= _LEAST_OUTLINE
        outline = [_around(corners, own.file)] if is_long else []
        yield {"cxcywhn": [numbers[1:5], *outline]}


@YOLO.label_writer
class YoloWriter:
    """Writes ``images/PART/STEM.png``, ``labels/PART/STEM.txt`` and ``data.yaml``.

    A frame without boxes has an empty label file. Distance bands are folders like
    ``labels``: ``label50/PART/STEM.txt``.

    Notes
    -----
    Lines are ``class cx cy w h`` as shares of the frame's own size, of the rectangle
    clipped to the image. ``data.yaml`` has no ``path``, which would be joined to a
    folder of the user's settings.
    """

    traits: ClassVar[Traits] = Traits(
        image="images/{part}/{stem}{suffix}",
        needs_key_list=True,
        needs_flat_names=True,
        own=OwnReading(line_spans, line_rectangles),
    )

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._parts: dict[str, None] = {}
        self._beside: list[object] = []

    def labels(self, band: str, out: OutFrame) -> None:
        """One label file: of a distance band, or of all boxes if `band` is empty."""
        self._parts[out.part] = None
        stored = stored_labels(out.frame.given, YOLO.name)
        if BESIDE in stored and not band:
            self._beside.append(stored[BESIDE])
        if out.own is None:
            text = "".join(label_lines(out.boxes, out.frame.wh))
        else:
            self._context.note_own(band)
            numbers = {box.row: str(box.class_number) for box in out.boxes}
            text = out.own.with_words(numbers, fewest_columns=RAW_COLUMNS + 1)
        folder = band or "labels"
        self._context.sink(f"{folder}/{out.part}/{out.stem}.txt", [text.encode()])

    def finish(self) -> None:
        """The list of classes and where the images are."""
        beside = joined_beside(self._beside)
        # The folders of each part by what it is for, the classes, and what came beside
        folders: dict[str, list[str]] = {"train": [], "val": []}
        there = list(self._parts) or completed_parts(())
        for part in there:
            if role := role_of_part(part):
                folders.setdefault(role, []).append(f"images/{part}")
        everything = [f"images/{part}" for part in there]
        for role, other in (("train", "val"), ("val", "train")):
            folders[role] = folders[role] or folders[other] or everything
        document: dict[str, object] = {
            **{
                role: some[0] if len(some) == 1 else some
                for role, some in folders.items()
            },
            "names": dict(enumerate(self._context.head.classes)),
            **({"nc": len(self._context.head.classes)} if "nc" in beside else {}),
        }
        document |= {key: beside[key] for key in beside if key not in document}
        text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True)
        self._context.sink("data.yaml", [text.encode("utf-8", "replace")])


_DECIMALS: Final = 9
"""Finer than a thousandth of a pixel in the largest image."""

_HALF_UNITS: Final = 10**_DECIMALS // 2
"""Edges are rounded to two units of the last decimal, so that centres are exact."""

_LINE: Final = f"%d {' '.join([f'%.{_DECIMALS}f'] * 4)}\n"


def label_lines(boxes: LabelBoxes, wh: tuple[int, int]) -> Iterator[str]:
    """Centres and extents as shares of the sides, so rounded that edges are exact.

    If centre and extent were rounded each by itself, their edges could lie beyond the
    image by the last digit; reading, clipping and writing them would then change
    digits.
    """
    edges = np.rint(boxes.xyxy / np.array([*wh, *wh]) * _HALF_UNITS)
    low, high = edges[:, :2], edges[:, 2:]
    shares = np.hstack([(low + high) / 2, high - low]) / _HALF_UNITS
    numbered = zip(boxes.class_number.tolist(), shares.tolist(), strict=True)
    return (_LINE % (number, *share) for number, share in numbered)
