"""A recording written again without some of its boxes, with nothing else changed.

`copy_recording` copies a folder file by file, and leaves out of its label files the
bytes of the boxes that are removed. So numbers stay as they were written, and names,
order, ids, splits, calibrations and companions as they came. The formats say where in
a label file each box is (`BoxSpan`).
"""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, TypeAlias

from filter_core.errors import LayoutError
from filter_core.formats.export import GivenAnnotation
from filter_core.formats.reading import (
    RECORDING_NAME,
    TEXT_SUFFIXES,
    FrameSet,
    FrameSource,
    Place,
    name_of,
    open_regular,
    read_label_bytes,
    real_paths,
)
from filter_core.formats.tables.json_items import read_object
from filter_core.formats.words import is_band, is_label_folder


class BoxSpan(NamedTuple):
    """The bytes of one box in a label file.

    Attributes
    ----------
    place : Place
        As the reader gives it (`BoxOrigin`).
    start, end : int
        Its first byte, and the one behind its last: a line with its end, an element
        with the space before it, or an item of a list without its commas.
    """

    place: Place
    start: int
    end: int


BoxSpans: TypeAlias = Callable[[BinaryIO], Iterable[BoxSpan]]
"""Gives the boxes of a label file from its start, in their order; raises `LayoutError`
if it cannot be read."""


def spans_of_lines(
    file: BinaryIO, is_box: Callable[[Sequence[str]], bool]
) -> Iterator[BoxSpan]:
    """The lines of a text file that are boxes, by their columns.

    Lines end as `str.splitlines` ends them, since readers use it. Raises `LayoutError`:
    it is not UTF-8.
    """
    try:
        text = file.read().decode("utf-8")
    except UnicodeDecodeError as exc:
        raise LayoutError("expected UTF-8 text") from exc
    mark = "\ufeff" if text.startswith("\ufeff") else ""
    start, place = len(mark.encode()), 0
    for line in text.removeprefix(mark).splitlines(keepends=True):
        end = start + len(line.encode())
        if is_box(line.split()):
            yield BoxSpan(place, start, end)
            place += 1
        start = end


def spans_of_items(
    file: BinaryIO, key: str, line: int | None = None
) -> Iterator[BoxSpan]:
    """The items of the list under a key of a JSON object, which may be a `line`."""
    items = (item for item in read_object(file, "labels") if item.key == key)
    there = (item for item in items if not item.is_empty)
    for number, item in enumerate(there):
        place = number if line is None else (line, number)
        yield BoxSpan(place, item.start, item.end)


SOURCE_LABELS: Final = "source_labels"
"""The key of an annotation that holds the label file which it was read from."""

BESIDE: Final = "beside"
"""The key of these labels for what their file says of the whole recording."""

STORED: Final = frozenset({"carlasimu", "coco", "kitti", "voc", "yolo"})
"""Formats that are written again from such a file; of COCO, ids and categories are."""

_MOST_STORED: Final = 4 << 20
"""Bytes of a label file that are stored with a frame."""


def with_labels(frame: FrameSource, layout: str) -> dict[str, object]:
    """The annotation of a frame, with its label file under `SOURCE_LABELS`.

    So whoever stores it can write it again in the same format. Of a file with many
    frames it is the frame's id, and the categories of its boxes. The first frame also
    has what the file says beside frames and boxes (`BESIDE`), and all categories.
    Without, if the format is none of `STORED`, or the file is large or not UTF-8.
    """
    annotation = dict(frame.annotation or {})
    origin = frame.origin
    if layout not in STORED or origin is None:
        return annotation
    beside = {BESIDE: dict(origin.beside)} if origin.beside else {}
    stored: dict[str, object] = {"format": layout, "file": origin.file.name, **beside}
    if origin.image_id is not None:
        stored["image_id"] = origin.image_id
        # Those of the frame's boxes; with what is beside, all of the file
        boxes, every = annotation.get("boxes"), origin.categories or {}
        own = {box.get("class") for box in boxes} if isinstance(boxes, list) else set()
        names = every.keys() & (own if origin.beside is None else every.keys())
        stored["categories"] = {name: every[name] for name in sorted(names)}
        return {**annotation, SOURCE_LABELS: stored}
    if origin.places is not None:
        return annotation
    files = {"text": origin.file, "calibration": origin.calibration}
    try:
        for name, path in files.items():
            if path is not None:
                content = read_label_bytes(path, path.name, _MOST_STORED)
                stored[name] = content.decode("utf-8")
                if b"\0" in content:  # no JSON that a database stores
                    return annotation
    except (LayoutError, UnicodeDecodeError):
        return annotation
    return {**annotation, SOURCE_LABELS: stored}


def stored_labels(annotation: GivenAnnotation, name: str) -> Mapping[str, object]:
    """What an annotation has under `SOURCE_LABELS` of this format; else empty."""
    stored = annotation.frame.get(SOURCE_LABELS) if annotation.may_be_of(name) else None
    if isinstance(stored, Mapping) and stored.get("format") == name:
        return stored
    return {}


def joined_beside(values: Iterable[object]) -> dict[str, object]:
    """What files say beside their frames, as one: lists joined, else the first value.

    `values` are those of frames under `BESIDE`.
    """
    joined: dict[str, object] = {}
    for beside in values:
        for key, value in beside.items() if isinstance(beside, Mapping) else ():
            there = joined.setdefault(key, value)
            if isinstance(there, list) and isinstance(value, list):
                joined[key] = there + [item for item in value if item not in there]
    return joined


_MOST_FOLDERS: Final = 100


def companions(source: Path, frames: FrameSet, used: Counter[str]) -> dict[str, int]:
    """How many files of each folder of a recording are of no frame.

    By path relative to `source`, sorted; of many folders, those above them.

    Parameters
    ----------
    source : Path
        The recording. A file has no companions.
    frames : FrameSet
        Empty for frames of a plug-in, of which it is not known which texts it has read.
    used : counter
        The number of files of frames, but for those of labels, by the paths of their
        folders (`folder_of`).
    """
    if frames.texts is None:
        return {}
    used = used + Counter(map(folder_of, frames.texts()))
    left: Counter[tuple[str, ...]] = Counter()
    for folder, _, names in os.walk(source):
        count = len(names) - used[folder] - (RECORDING_NAME in names)
        if count > 0:
            left[Path(folder).relative_to(source).parts] = count
    while len(left) > _MOST_FOLDERS:
        depth = max(map(len, left)) - 1
        above: Counter[tuple[str, ...]] = Counter()
        for parts, count in left.items():
            above[parts[:depth]] += count
        left = above
    return {"/".join(parts) or ".": count for parts, count in sorted(left.items())}


def folder_of(path: Path | str) -> str:
    """The path of a file's folder, quicker than by ``path.parent``."""
    return str(path).rpartition(os.sep)[0]


Rectangles: TypeAlias = Mapping[str, Sequence[Sequence[float]]]
"""The rectangles that a box of a label file may have, by their key in an annotation."""


class OwnReading(NamedTuple):
    """How label files of a format are compared with annotations, and cut.

    `rectangles` gives those of each box; raises `LayoutError` if the file cannot be
    read.
    """

    box_spans: BoxSpans
    rectangles: Callable[[OwnLabels], Iterable[Rectangles]]


@dataclass(frozen=True)
class OwnLabels:
    """The label file of a frame that came in the format in which it is written.

    Its name is without folders; `spans` are the bytes of the annotation's boxes, in
    their order.
    """

    content: bytes
    file: str
    spans: tuple[BoxSpan, ...]

    @property
    def text(self) -> str:
        """Its text, as readers get it."""
        return self.content.decode("utf-8-sig")

    def with_rows(self, rows: Collection[int]) -> bytes:
        """The file with these boxes, and none of the others."""
        gone = {span.place for row, span in enumerate(self.spans) if row not in rows}
        return b"".join(_pieces(BytesIO(self.content), self.spans, gone))

    def with_words(self, words: Mapping[int, str], *, fewest_columns: int = 1) -> str:
        """The file of lines with these boxes; each begins with its word.

        Lines with fewer columns begin with a number that is none of a class.
        """
        pieces, at = [], 0
        for row, (_, start, end) in enumerate(self.spans):
            pieces.append(self.content[at:start].decode())
            at = end
            line = self.content[start:end].decode()
            columns = line.split(maxsplit=fewest_columns)
            if row in words and len(columns) >= fewest_columns:
                line = line.replace(columns[0], words[row], 1)
            pieces.append(line if row in words else "")
        return "".join([*pieces, self.content[at:].decode()])


def own_labels(
    annotation: GivenAnnotation, name: str, reading: OwnReading
) -> OwnLabels | None:
    """The label file that an annotation came from, in the format of this name.

    None if there is none, or if it has other boxes than the annotation, which somebody
    may have changed.
    """
    stored = stored_labels(annotation, name)
    text, file = stored.get("text"), stored.get("file")
    if not isinstance(text, str) or not isinstance(file, str):
        return None
    content = text.encode("utf-8", "surrogatepass")
    try:
        spans = tuple(reading.box_spans(BytesIO(content)))
        own = OwnLabels(content, file, spans)
        rectangles = list(reading.rectangles(own))
    except LayoutError:
        return None
    boxes = annotation.boxes
    if not len(boxes) == len(spans) == len(rectangles):
        return None
    pairs = zip(boxes, rectangles, strict=True)
    is_same = all(
        any(box.get(form) in numbers for form, numbers in those.items())
        for box, those in pairs
    )
    return own if is_same else None


@dataclass(frozen=True)
class LeftBehind:
    """What of a recording is not in its copy.

    Files of frames that lie `outside` the folder, which labels name as before; and
    `special` ones: pipes, sockets and devices in the folder, relative to it.
    """

    outside: tuple[Path, ...] = ()
    special: tuple[str, ...] = ()


class RecordingCopy:
    """Writes the folder or the file that was read again, without some of its boxes.

    `box_spans` is that of its format.
    """

    def __init__(self, source: Path, box_spans: BoxSpans) -> None:
        self.source, self.box_spans = source, box_spans
        self.folder = source if source.is_dir() else source.parent
        self._removed: dict[Path, set[Place]] = {}
        self._labels: dict[Path, None] = {}
        self._files: dict[Path, None] = {}
        self._band_folders: dict[Path, list[Path]] = {}

    def add(self, frame: FrameSource, rejected: Iterable[int] = ()) -> None:
        """Note a frame, and the rows of its boxes that are to be removed.

        Raises `LayoutError`: it is not known where its boxes are, or their file is not
        in the folder.
        """
        own = frame.origin.file if frame.origin else None
        files = (own, frame.image, frame.segmentation, *frame.others.values())
        for file in filter(None, files):
            # Those in a folder are found there, and there may be millions.
            if self.source.is_file() or self._place_of(file) is None:
                self._files[file] = None
        rows = list(rejected)
        if not rows:
            return
        if frame.origin is None:
            raise LayoutError(
                f"frame {frame.key}: it is not known where its boxes are in its labels"
            )
        labels = frame.origin.file
        if self._place_of(labels) is None:
            raise LayoutError(
                f"{labels.name}: expected labels in {name_of(self.folder)}, found them "
                "outside; give the folder that holds images and labels"
            )
        self._labels[labels] = None
        places = self._removed.setdefault(_real(labels), set())
        places.update(map(frame.origin.place, rows))

    def _place_of(self, file: Path) -> Path | None:
        """Where a file is in the copy, relative to it; None if it is not there."""
        if file.is_relative_to(self.folder):
            place = file.relative_to(self.folder)
            if ".." not in place.parts:
                return place
        folder, path = real_paths(self.folder, file)
        return path.relative_to(folder) if path.is_relative_to(folder) else None

    def write(self, target: Path) -> LeftBehind:
        """Write the copy into an empty folder.

        Of a file that was read alone, the files of its frames are copied with it.

        Raises
        ------
        LayoutError
            A label file is not as it was when it was read.
        OSError
            A file cannot be read or written.
        """
        for file in self._labels:
            for band in self._in_bands(file):
                places = set(self._places_again(file, band))
                self._removed.setdefault(_real(band), set()).update(places)
        placed = {file: self._place_of(file) for file in (*self._files, self.source)}
        outside = tuple(file for file, place in placed.items() if place is None)
        if self.source == self.folder:
            tree = _Tree(_real(self.folder), target, self._copy)
            tree.copy(self.folder, target, (tree.root,))
            return LeftBehind(outside, tuple(tree.special))
        for file, place in placed.items():
            if place is not None and file.is_file():
                (target / place).parent.mkdir(parents=True, exist_ok=True)
                self._copy(file, target / place)
        return LeftBehind(outside)

    def _in_bands(self, file: Path) -> Iterator[Path]:
        """The label files of distance bands that hold boxes of this one again."""
        for band in self._bands(file.parent):
            if (band / file.name).is_file():
                raise LayoutError(
                    f"{band.name}/{file.name} has boxes of {file.name} again under "
                    "other ids; remove it, or write new labels with --option bands=..."
                )
        for above in file.parents:
            if above == self.folder or not above.is_relative_to(self.folder):
                return
            if is_label_folder(above.name):
                beside = (band for band in self._bands(above.parent) if band != above)
                again = (band / file.relative_to(above) for band in beside)
                yield from filter(Path.is_file, again)

    def _bands(self, folder: Path) -> list[Path]:
        """The folders of distance bands in a folder."""
        if folder not in self._band_folders:
            names = sorted(path for path in folder.iterdir() if is_band(path.name))
            self._band_folders[folder] = [path for path in names if path.is_dir()]
        return self._band_folders[folder]

    def _places_again(self, file: Path, band: Path) -> Iterator[Place]:
        """The places in the labels of a distance band of removed boxes of a file."""
        places = self._removed[_real(file)]
        (content, spans), (others, again) = (
            (path.read_bytes(), self._spans(path)) for path in (file, band)
        )
        gone = Counter(
            content[span.start : span.end].strip()
            for span in spans
            if span.place in places
        )
        for span in again:
            text = others[span.start : span.end].strip()
            if gone[text] > 0:
                gone[text] -= 1
                yield span.place

    def _spans(self, path: Path) -> Iterator[BoxSpan]:
        with open_regular(path) as file:
            yield from self.box_spans(file)

    def _copy(self, file: Path, place: Path) -> None:
        """Copy a file; images and the like are linked, texts are not.

        So who changes a text of the copy later does not change the recording.
        """
        places = self._removed.get(_real(file))
        if places:
            with place.open("xb") as copy:
                copy.writelines(self._pieces(file, places))
            shutil.copymode(file, place)
            return
        if file.suffix.lower() not in TEXT_SUFFIXES:
            with suppress(OSError):  # another disk, or one without links
                os.link(_real(file), place)
                return
        shutil.copy2(file, place)

    def _pieces(self, path: Path, places: Collection[Place]) -> Iterator[bytes]:
        """A label file without some of its boxes."""
        try:
            with open_regular(path) as file:
                yield from _pieces(file, self._spans(path), places)
        except LayoutError as exc:
            raise LayoutError(f"{path.name}: {exc.detail}") from exc


def _pieces(
    file: BinaryIO, spans: Iterable[BoxSpan], places: Collection[Place]
) -> Iterator[bytes]:
    cuts = list(_cuts(spans, places, file))
    at = 0
    for start, end in cuts:
        yield from _bytes_of(file, at, start)
        at = end
    yield from _bytes_of(file, at, None)


_LONGEST_GAP: Final = 1 << 16
"""Bytes of a comma between two items with the space around it."""


def _cuts(
    spans: Iterable[BoxSpan], places: Collection[Place], file: BinaryIO
) -> Iterator[tuple[int, int]]:
    """The bytes to leave out: boxes, and the commas of items of a list.

    The comma before an item goes with it; that before the first item that stays, too.
    """
    left = set(places)
    before: int | None = None
    stays = False  # an item of the list
    for place, start, end in spans:
        is_removed = place in places
        if before is not None and (is_removed or not stays):
            gap = _bytes_of(file, before, min(start, before + _LONGEST_GAP))
            if b"".join(gap).strip() == b",":
                yield before, start
            else:
                stays = False
        if is_removed:
            left.discard(place)
            yield start, end
        else:
            stays = True
        before = end
    if left:
        raise LayoutError(
            f"expected the boxes that were read from it, found {len(left)} fewer; it "
            "changed in the meantime"
        )


_PIECE: Final = 1 << 20


def _bytes_of(file: BinaryIO, start: int, end: int | None) -> Iterator[bytes]:
    """A part of a file in pieces; None: up to its end."""
    file.seek(start)
    while end is None or start < end:
        piece = file.read(_PIECE if end is None else min(_PIECE, end - start))
        if not piece:
            return
        yield piece
        start += len(piece)


def _real(path: Path) -> Path:
    return real_paths(path)[0]


@dataclass
class _Tree:
    """Copies a folder with everything in it.

    A link into the folder becomes one into the copy; of a link out of it, the file or
    the folder that it leads to is copied.
    """

    root: Path
    target: Path
    copy_file: Callable[[Path, Path], None]
    special: list[str] = field(default_factory=list)

    def copy(self, folder: Path, target: Path, above: tuple[Path, ...]) -> None:
        """Copy what a folder holds; `above` are the folders that are being copied."""
        target.mkdir(exist_ok=True)
        for path in sorted(folder.iterdir()):
            place = target / path.name
            if path.is_symlink() and self._link(path, place):
                continue
            if path.is_dir():
                real = _real(path)
                if real in above:
                    raise LayoutError(
                        f"{path.name}: expected a folder, found a link to one that it "
                        "is in, which has no end"
                    )
                self.copy(path, place, (*above, real))
            elif path.is_file():
                self.copy_file(path, place)
            else:
                self.special.append(place.relative_to(self.target).as_posix())

    def _link(self, path: Path, place: Path) -> bool:
        """Whether a link was written again as a link."""
        real = _real(path)
        if not path.exists():  # it leads nowhere
            place.symlink_to(path.readlink())
            return True
        if not real.is_relative_to(self.root):
            return False
        leads_to = self.target / real.relative_to(self.root)
        place.symlink_to(os.path.relpath(leads_to, place.parent))
        return True
