"""Boxes in tables: CSV, TSV, JSON, JSON Lines or NPZ, as people's own scripts write.

A file has the boxes of one frame, one in each row, or those of many frames, each row
with the frame's name. `filter_core.formats.tables.fields` says what is what in a row.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import compress, islice
from pathlib import Path
from typing import Final

from filter_core.annotation.frame import FORMS_3D, GEOMETRIES
from filter_core.errors import LayoutError
from filter_core.formats.format import FOLDER_OPTIONS, Format, Recognition, Source
from filter_core.formats.matching import FileIndex, FrameFileNames, frame_of
from filter_core.formats.reading import (
    GZIP,
    IMAGE_SUFFIXES,
    KEYS_NAME,
    FrameSet,
    FrameSource,
    StreamFacts,
    Unmatched,
    annotated,
    frame_key,
    frame_size,
    last_name,
    split_name,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.streams import Streams
from filter_core.formats.tables.box_rows import BoxReader
from filter_core.formats.tables.cameras import Cameras
from filter_core.formats.tables.fields import (
    BOXES,
    BoxFields,
    forms_of,
    recognised_fields,
)
from filter_core.formats.tables.patterns import (
    CAMERA,
    FRAME,
    LABELS,
    FilePatterns,
    PatternFiles,
    PatternFrame,
    Values,
    plain,
)
from filter_core.formats.tables.rows import (
    MAX_BYTES,
    Lines,
    Row,
    Span,
    read_document,
    table_suffix,
)
from filter_core.values import shown

TABLE: Final = Format(
    name="table",
    title="Tables of boxes",
    docs_row=(
        "boxes as rows of CSV, TSV, JSON, JSON Lines (each also `.gz`) or NPZ: a file "
        "for each frame, or one for many frames; columns under their usual names, or "
        "as `boxes.fields` of a [description](#tables-of-boxes) says"
    ),
    recognised_by="files of boxes (.csv, .tsv, .json, .jsonl or .npz)",
    read_options=FOLDER_OPTIONS
    | {"key", "fields", "cameras", "classes", "default_class"},
)

_LOOKED_AT: Final = 64
"""Files that are looked at to recognise the layout."""


@TABLE.recogniser
def _recognise(source: Source) -> Recognition:
    root = source.path
    if root.is_file():
        return "possible" if _is_of_boxes(root) else "none"
    if not any(True for _ in source.names(IMAGE_SUFFIXES)):
        return "none"
    names = (name for name in source.names(None) if table_suffix(name))
    looked_at = islice(names, _LOOKED_AT)
    return (
        "fallback" if any(_is_of_boxes(root / name) for name in looked_at) else "none"
    )


def _is_of_boxes(path: Path) -> bool:
    """Whether a file has rows of boxes under usual names; an annotation is no table."""
    if not table_suffix(path.name):
        return False
    try:
        document = read_document(path, path.name)
        if isinstance(document, Mapping) and "boxes" in document:
            return path.name.lower().endswith(".npz")
        row = next(_first_rows(document, BoxReader(BoxFields())), None)
    except LayoutError:
        return False
    return row is not None and bool(forms_of(recognised_fields(row)))


def _first_rows(document: object, reader: BoxReader) -> Iterator[object]:
    """The rows of a file of one frame or of many."""
    is_list = isinstance(document, list)
    pairs = document if isinstance(document, Lines) else reader.frames_in(document, "")
    for _, row in pairs:
        if reader.holds_boxes(row.value) and not (is_list and row.value is document):
            yield from (box.value for _, box in reader.boxes_in(row.value, ""))
        else:
            yield row.value


@TABLE.reader
def read_table(source: Path, options: RecordingDescription) -> FrameSet:
    """A frame for each image, with the boxes of the rows that belong to it.

    Raises `LayoutError`: a file with the labels of many frames cannot be read, or has
    no column with the frame's name.
    """
    root = source if source.is_dir() else source.parent
    reader = BoxReader(
        options.fields, options.classes or (), options.default_class, options.corners
    )
    if options.key or LABELS in options.files.roles:
        listing = _by_patterns(root, options)
    else:
        listing = _by_names(root, source, options)
    names = _FrameNames(listing.frames)
    # The files with the labels of many frames, and those that are something else
    tables, errors = [], []
    for name, values in listing.tables.items():
        try:
            tables.append(_Table(listing.folder / name, name, values, reader, names))
        except LayoutError as exc:
            errors.append((name, exc))
    if errors and not tables:
        raise errors[0][1]
    strange = [Unmatched(name, error.detail) for name, error in errors]
    shares = Counter(frame.files.label for frame in listing.frames if frame.files.label)
    labels = _Labels(reader, Cameras(root, options.cameras), tables, shares, options)
    of_rows = (row for each in tables for row in each.unmatched)
    unmatched = (*listing.unmatched, *strange, *of_rows)

    def frames() -> Iterator[FrameSource]:
        reader.left_out = 0
        for index, frame in enumerate(listing.frames):
            read = partial(labels.annotation, index, frame, listing.folder)
            own = replace(frame_of(frame.files, root), label=None)
            yield annotated(own, partial(read, own))

    def left_out() -> str:
        return (
            f"{reader.left_out} rows have no rectangle, or that of a box behind the "
            "camera; they are left out"
        )

    return FrameSet(
        layout="table",
        frames=frames,
        count=len(listing.frames),
        unmatched=unmatched,
        notes=lambda: (*listing.notes, *([left_out()] if reader.left_out else [])),
        streams=listing.streams,
    )


@dataclass(frozen=True)
class _Found:
    """The frames of a folder, and its files of labels, which may be in another folder.

    `tables` are files with the labels of many frames, each with the values that all of
    its frames share.
    """

    frames: list[PatternFrame]
    folder: Path
    tables: Mapping[str, Values] = field(default_factory=dict)
    unmatched: tuple[Unmatched, ...] = ()
    notes: tuple[str, ...] = ()
    streams: tuple[StreamFacts, ...] = ()


def _by_patterns(root: Path, options: RecordingDescription) -> _Found:
    for name in ("segmentation", "labels"):
        if getattr(options, name) is not None:
            raise LayoutError(f"expected {name} among `files`, found its folder, too")
    roles, ignored = options.files.roles, options.files.ignored
    files = FilePatterns(roles, (*ignored, *options.cameras.files))
    matched = PatternFiles(root, files)
    is_of_many = LABELS in roles and FRAME not in roles[LABELS].names
    frames = matched.frames(options.key)
    unmatched = [*matched.left_over(labels=not is_of_many)]
    tables = matched.labels if is_of_many else {}
    if LABELS in roles:
        has_labels = [
            bool(frame.files.label)
            or any(values.items() <= frame.values.items() for values in tables.values())
            for frame in frames
        ]
        unmatched += (
            Unmatched(
                frame.files.image or frame.files.key, "no label file for this image"
            )
            for frame, has in zip(frames, has_labels, strict=True)
            if not has
        )
        frames = [*compress(frames, has_labels)]
    if is_of_many:
        frames = [
            frame._replace(files=replace(frame.files, label="")) for frame in frames
        ]
    return _Found(frames, root, tables, tuple(unmatched))


def _by_names(root: Path, source: Path, options: RecordingDescription) -> _Found:
    """Images by their streams; labels that are called like them, or all in one file."""
    folder = options.labels or root
    streams = Streams(root, options)
    images = FileIndex(streams.images)
    cameras = options.cameras.files
    tables = [
        name
        for name in options.files.walk(root, folder, None)
        if table_suffix(name)
        and last_name(name) != KEYS_NAME
        and not any(camera.match(name) is not None for camera in cameras)
    ]
    if source.is_file():
        tables = [source.name]
    own = FileIndex(tables, _key_of_table)
    label_of = {
        key: own.take(key, by_base=images.is_only_base(key)) for key, _ in images
    }
    are_of_many = not any(label_of.values())
    names = [
        FrameFileNames(key, "" if are_of_many else label_of[key] or "", image)
        for key, image in images
        if are_of_many or label_of[key]
    ]
    completed, left_over = streams.complete(names, "image")
    unmatched = [*images.unmatched, *left_over]
    if not are_of_many:
        unmatched += own.left_over("no image of this name")
        unmatched += (
            Unmatched(image, "no label file for this image")
            for key, image in images
            if not label_of[key]
        )
    return _Found(
        [
            PatternFrame(
                frame, {FRAME: last_name(frame.key), **streams.values_of(frame.image)}
            )
            for frame in completed
        ],
        folder,
        {name: {} for name in tables} if are_of_many else {},
        tuple(unmatched),
        streams.notes,
        streams.facts,
    )


def _key_of_table(name: str) -> str:
    return frame_key(name[: -len(GZIP)] if name.lower().endswith(GZIP) else name)


_NUMBER: Final = re.compile(r"[0-9]{1,18}")


class _FrameNames:
    """Finds frames by what rows call them."""

    def __init__(self, frames: Sequence[PatternFrame]) -> None:
        self._frames = frames
        self._exact: dict[str, list[int]] = {}
        self._plain: dict[str, list[int]] = {}
        self._numbers: dict[int, list[int]] = {}
        for index, (files, values) in enumerate(frames):
            image = files.image or ""
            names = (files.key, values[FRAME], image, last_name(image))
            for name in dict.fromkeys(
                (*names, *(split_name(text)[0] for text in names))
            ):
                self._exact.setdefault(name, []).append(index)
            self._plain.setdefault(plain(values[FRAME]), []).append(index)
            numbers = _NUMBER.findall(last_name(values[FRAME]))
            if len(numbers) == 1:  # frame 7 is rgb_0007
                self._numbers.setdefault(int(numbers[0]), []).append(index)

    def of(self, name: str, camera: str, values: Values) -> list[int]:
        """The frames of this name, camera and values; several if it is unclear."""
        path = name.replace("\\", "/").removeprefix("./")
        last = last_name(path)
        stem = split_name(last)[0] if last.lower().endswith(IMAGE_SUFFIXES) else last
        indexes = self._exact.get(path) or self._exact.get(split_name(path)[0])
        indexes = indexes or self._exact.get(last) or self._exact.get(stem)
        indexes = indexes or self._plain.get(plain(stem), [])
        if not indexes and _NUMBER.fullmatch(stem):
            indexes = self._numbers.get(int(stem), [])
        frames = self._frames
        same = [
            index for index in indexes if values.items() <= frames[index].values.items()
        ]
        if len(same) > 1 and path != last:
            same = [index for index in same if self._ends_in(index, path)] or same
        return (
            [index for index in same if self.is_of(index, camera)] if camera else same
        )

    def _ends_in(self, index: int, path: str) -> bool:
        files = self._frames[index].files
        return any(f"/{name}".endswith(f"/{path}") for name in (files.image, files.key))

    def is_of(self, index: int, camera: str) -> bool:
        """Whether a frame is of a camera, as far as its name says one."""
        own = self._frames[index].values.get(CAMERA)
        return own is None or own.casefold() == camera.casefold()


class _Table:
    """A file with the labels of many frames, by frame.

    `unmatched` are rows that belong to no frame.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        values: Values,
        reader: BoxReader,
        frames: _FrameNames,
    ) -> None:
        self._name, self._reader, self._frames = name, reader, frames
        self._values = values
        self.unmatched: list[Unmatched] = []
        self._lines: Lines | None = None
        self._spans: dict[int, list[Span]] = {}
        self._rows: dict[int, list[Row]] = {}
        self._lost: dict[str, list[str]] = {}
        document = read_document(path, name, MAX_BYTES)
        if isinstance(document, Lines):
            if document.columns is not None:
                reader.check_columns(document.columns, name)
            self._lines = document
            for span, row in document:
                for index in self._indexes(None, row):
                    spans = self._spans.setdefault(index, [])
                    if spans and spans[-1].end == span.start:
                        spans[-1] = spans[-1]._replace(end=span.end)
                    else:
                        spans.append(span)
        else:
            for named, row in reader.frames_in(document, name):
                for index in self._indexes(named, row):
                    self._rows.setdefault(index, []).append(row)
        self._list_lost()

    def _indexes(self, named: object, row: Row) -> list[int]:
        """The frames that a row belongs to; one that belongs to none is noted."""
        text, camera = self._names(named, row)
        if text is None:
            why = row.problem.detail if row.problem else "no frame"
            self._lost.setdefault(why, []).append(row.at)
            return []
        indexes = self._frames.of(text, camera, self._values)
        if not indexes:
            about = f"{text} of camera {camera}" if camera else text
            self._lost.setdefault(f"no image of frame {shown(about)}", []).append(
                row.at
            )
        return indexes

    def _names(self, named: object, row: Row) -> tuple[str | None, str]:
        """What a row calls its frame and its camera."""
        name = self._reader.cell("frame", row.value) if named is None else named
        return _text(name), _text(self._reader.cell("camera", row.value)) or ""

    def _list_lost(self) -> None:
        without = self._lost.get("no frame", [])
        if without and not self._rows and not self._spans:
            raise LayoutError(
                f"{without[0]}: expected the name of a frame (frame, image, "
                "file_name ...), found none; `boxes: {fields: {frame: ...}}` in "
                "recording.yaml says which column or path it is"
            )
        for why, places in self._lost.items():
            rows = f" ({len(places)} rows, the first is {places[0]})"
            self.unmatched.append(Unmatched(self._name, why + rows))

    def rows(self, index: int) -> Iterator[Row]:
        """What it has of a frame."""
        if self._lines is not None:
            spans = self._spans.get(index, ())
            yield from (row for _, row in self._lines.rows(spans))
        yield from self._rows.get(index, ())

    def shares(self, row: Row) -> int:
        """How many frames a row belongs to."""
        text, camera = self._names(None, row)
        return len(self._frames.of(text, camera, self._values)) if text else 1


def _text(value: object) -> str | None:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    is_name = isinstance(value, str | int) and not isinstance(value, bool)
    return str(value).strip() if is_name else None


@dataclass(frozen=True)
class _Labels:
    """Reads the annotations of frames."""

    reader: BoxReader
    cameras: Cameras
    tables: Sequence[_Table]
    shares: Mapping[str, int]
    options: RecordingDescription

    def annotation(
        self, index: int, frame: PatternFrame, folder: Path, source: FrameSource
    ) -> dict[str, object]:
        """The boxes of a frame and its camera."""
        labels: object = None
        boxes: list[dict[str, object]] = []
        regions: list[object] = []
        if name := frame.files.label:
            document = read_document(folder / name, name)
            if (annotation := self._annotation_in(document)) is not None:
                return annotation
            labels = document
            if isinstance(document, Lines):
                if document.columns is not None:
                    self.reader.check_columns(document.columns, name)
                rows = [row for _, row in document]
                labels = [row.value for row in rows]
                box_rows = self._in_rows(rows)
            else:
                box_rows = self.reader.boxes_in(document, name)
            boxes = self._boxes(box_rows, frame, self.shares[name], regions)
        for table in self.tables:
            for row in table.rows(index):
                labels = row.value if labels is None else labels
                box_rows = self._in_rows([row])
                boxes += self._boxes(box_rows, frame, table.shares(row), regions)
        wh = frame_size(source) if self.options.cameras.places else None
        camera = self.cameras.of(frame.values, labels, wh)
        # The map that labels, or the first of their rows, say
        first = labels[0] if isinstance(labels, list) and labels else labels
        town = self.reader.cell("map", first)
        return {
            "boxes": self._with_ids(boxes),
            **({"camera": camera} if camera else {}),
            **({"dontcare": regions} if regions else {}),
            **({"map": town} if isinstance(town, str) else {}),
        }

    def _annotation_in(self, document: object) -> dict[str, object] | None:
        """What a file holds if it is an annotation of the API, with camera and all."""
        is_other = {"fields", "cameras"} & self.options.changed.keys()
        if is_other or not isinstance(document, Mapping):
            return None
        boxes = document.get(BOXES)
        is_ours = isinstance(boxes, list) and all(
            isinstance(box, Mapping) and not box.keys().isdisjoint(GEOMETRIES)
            for box in boxes
        )
        return dict(document) if is_ours else None

    def _in_rows(self, rows: Iterable[Row]) -> Iterator[tuple[str, Row]]:
        for row in rows:
            if self.reader.holds_boxes(row.value):
                yield from self.reader.boxes_in(row.value, row.at)
            else:
                yield "", row

    def _boxes(
        self,
        rows: Iterable[tuple[str, Row]],
        frame: PatternFrame,
        shares: int,
        regions: list[object],
    ) -> list[dict[str, object]]:
        """The boxes of rows that are not those of another camera.

        Rectangles that are to be ignored are added to `regions`.
        """
        boxes = []
        own = frame.values.get(CAMERA)
        for class_name, row in rows:
            camera = _text(self.reader.cell("camera", row.value))
            is_known = own is not None and camera is not None
            if is_known and f"{camera}".casefold() != f"{own}".casefold():
                continue
            box = self.reader.box(row, class_name)
            if box is None:
                continue
            if shares > 1 and not is_known and box.keys().isdisjoint(FORMS_3D):
                raise LayoutError(
                    f"{row.at}: expected a rectangle of one frame, found that of "
                    f"{shares}, such as {frame.files.key}; `boxes: {{fields: {{camera: "
                    "...}}` in recording.yaml says which column or path is the camera"
                )
            if self.reader.is_region(row.value):
                regions.append(box.get("xyxy"))
            else:
                boxes.append(box)
        return boxes

    def _with_ids(self, boxes: list[dict[str, object]]) -> list[dict[str, object]]:
        """Without ids that were recognised by their name, and are not unique."""
        ids = [str(box["id"]) for box in boxes if "id" in box]
        if len({*ids}) < len(ids) and "id" not in self.options.fields.paths:
            for box in boxes:
                box.pop("id", None)
        return boxes
