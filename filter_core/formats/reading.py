"""Shared by all readers of folders: their result, and matching the files of a frame.

A reader returns a `FrameSet`. Files of one frame have the same name in parallel
folders; keys that are no valid file names are read from the list in an export
(``frames.jsonl``).
"""

from __future__ import annotations

import errno
import math
import os
import re
import stat
import unicodedata
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import BinaryIO, Final, NamedTuple, TypeAlias
from urllib.parse import unquote

from filter_core.errors import FilterError, JsonError, LayoutError
from filter_core.formats.words import FOLDER_WORDS, holds_boxes, is_band
from filter_core.images.header import read_image_size
from filter_core.json_text import read_json
from filter_core.values import shown

MAX_LABEL_BYTES: Final = 16 * 1024 * 1024
"""Larger files are refused: ten thousand boxes take under a megabyte."""

_TO_READ: Final = (
    os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
)

MAX_KEY: Final = 512

KEYS_NAME: Final = "frames.jsonl"
"""The list of frames' keys in an export, by which the keys are restored."""

MANIFEST_NAME: Final = "manifest.jsonl"

RECORDING_NAME: Final = "recording.yaml"
"""The name under which a description is found beside the data."""

IMAGE_SUFFIXES: Final = (".png", ".jpg", ".jpeg")

TABLE_SUFFIXES: Final = (".csv", ".tsv", ".json", ".jsonl", ".npz")
"""Files of rows; each of them but the last may also be compressed, with `GZIP`."""

GZIP: Final = ".gz"

NOTES_SUFFIXES: Final = (".txt", ".xml", ".json", ".jsonl", ".yaml", ".yml", ".names")
"""Files of labels and lists that readers open, other than tables alone."""

TEXT_SUFFIXES: Final = (*NOTES_SUFFIXES, ".csv", ".tsv", ".npz", GZIP)
"""Files of labels that some reader opens. The page has these, too (`TEXT` in
archive.js)."""


class GivenAnswer(NamedTuple):
    """A person's answer on a box, as a file has it.

    Attributes
    ----------
    box : str
        The id of the box in its frame.
    verdict : ``keep``, ``reject`` or ``unsure``
    created_at : str
        When it was given (RFC 3339).
    """

    box: str
    verdict: str
    reviewer: str
    comment: str
    created_at: str


class Labelled(NamedTuple):
    """Who labelled a frame in another program, and when, as far as its file says.

    Without a name, it was a person whom the file does not name.
    """

    by: str | None = None
    at: datetime | None = None


def time_of(text: object) -> datetime | None:
    """A time as other programs write it, without a zone in UTC; None if it is none."""
    try:
        time = datetime.fromisoformat(str(text).strip().replace("Z", "+00:00"))
    except ValueError:
        return None
    return time if time.tzinfo else time.replace(tzinfo=timezone.utc)


Place: TypeAlias = int | tuple[int, int]
"""Where a box is in a label file: its number, or those of its line and of the box in
it. The reader of a format and its `box_spans` count alike, from 0."""


class BoxOrigin(NamedTuple):
    """Where the boxes of a frame were read from.

    Attributes
    ----------
    file : Path
        The label file.
    places : tuple of Place, or None
        Of each box of the annotation; None: the file has no other boxes, and they are
        in its order.
    calibration : Path or None
        The file that says how the labels' 3D boxes are seen.
    image_id : int, str or None
        The frame's id in the file.
    categories : mapping of str to mapping, or None
        What the file says of classes, by name, if it says anything.
    beside : mapping or None
        What the file, or the folder's list of classes, says beside frames and boxes:
        of the first frame of each only.
    """

    file: Path
    places: tuple[Place, ...] | None = None
    calibration: Path | None = None
    image_id: int | str | None = None
    categories: Mapping[str, Mapping[str, object]] | None = None
    beside: Mapping[str, object] | None = None

    def place(self, row: int) -> Place:
        """The place of the box in this row of the annotation."""
        return row if self.places is None else self.places[row]


@dataclass(frozen=True)
class FrameSource:
    """The files and the annotation of one frame of a folder.

    Attributes
    ----------
    key : str
        Names the frame; may contain ``/``.
    annotation : mapping or None
        As `parse_annotation` takes it; None if there is a `problem`.
    others : mapping of str to Path
        ``depth``, ``instances``, ``lidar``, ``radar``, ``ignore_mask`` where given.
    problem : FilterError or None
        Why the frame cannot be used; other frames are still read.
    label : str or None
        The label file that belongs to an image of the same name, relative to the folder
        of the labels; None where the layout names images otherwise.
    origin : BoxOrigin or None
        Where its boxes are, in formats that tell it; None also if it has no label file.
    shown : mapping of str to str
        Keys of a configuration, such as ``palette``, with the values that the images of
        the whole recording show; a configuration's own values win.
    answers : sequence of GivenAnswer
        Those of people on its boxes.
    labelled : Labelled or None
        None if no person is known to have labelled it in another program.
    plain_points : Path or None
        LiDAR points without tags, which are no evidence; exports may copy them.
    """

    key: str
    annotation: Mapping[str, object] | None
    image: Path | None = None
    segmentation: Path | None = None
    others: Mapping[str, Path] = field(default_factory=dict)
    problem: FilterError | None = None
    label: str | None = None
    origin: BoxOrigin | None = None
    shown: Mapping[str, str] = field(default_factory=dict)
    answers: Sequence[GivenAnswer] = ()
    labelled: Labelled | None = None
    plain_points: Path | None = None


def missing_image(frame: FrameSource) -> LayoutError | None:
    """The error about a label whose image is missing, if the frame needs the image.

    It needs none if another image or its camera give the size of the image.
    """
    pictures = frame.image or frame.segmentation or frame.others.get("instances")
    if frame.label is None or pictures or "camera" in (frame.annotation or {}):
        return None
    *first, last = IMAGE_SUFFIXES
    return LayoutError(
        f"{frame.label}: expected an image named {PurePosixPath(frame.label).stem} "
        f"({', '.join(first)} or {last}), found none",
        code="image_size_unknown",
    )


_HEADER_BYTES: Final = 1 << 16


def frame_size(frame: FrameSource) -> tuple[int, int] | None:
    """Width and height of a frame's images in px, or those of its camera; else None."""
    camera = (frame.annotation or {}).get("camera")
    for path in filter(None, (frame.image, frame.segmentation)):
        try:
            with open_regular(path) as file:
                return read_image_size(file.read(_HEADER_BYTES))
        except (OSError, FilterError):
            continue
    if isinstance(camera, Mapping):
        width, height = camera.get("width"), camera.get("height")
        if isinstance(width, int) and isinstance(height, int):
            return width, height
    return None


@dataclass(frozen=True)
class Unmatched:
    """A file that belongs to no frame, by its path relative to the folder, and why."""

    path: str
    why: str


_NAME: Final = re.compile(r"\S*[/.\[\d]\S*")
"""Words of a reason that may differ in other reasons of its kind."""


def kind_of_reason(why: str) -> str:
    """A reason of `Unmatched` without names and numbers: equal for those of a kind."""
    return _NAME.sub("...", why)


def counted_notes(
    counts: Mapping[str, int], sentences: Mapping[str, str]
) -> Iterator[str]:
    """The sentences with their counts, of those that are not 0."""
    for kind, sentence in sentences.items():
        if count := counts.get(kind):
            yield sentence.format(count)


class StreamFacts(NamedTuple):
    """Images that differ in the frame's part of their paths only, and have one role.

    Where several folders hold such images, as of cameras, they are one if one pattern
    names them.

    Attributes
    ----------
    role : str
        ``image`` for the camera's pictures; ``unclear``: names and pixels do not say.
    images : int
        How many there are.
    example : str
        The first of them, relative to the folder of the recording.
    told_by : tuple of str
        What told the role: ``name``, ``pixels``, ``description``, ``manifest``; empty
        for pictures of which nothing says that they are anything else.
    pattern : str or None
        Their paths below the folder of the recording, as ``files`` of a description
        names them: of all patterns that match an image, that of its stream is the most
        specific. None: no pattern does.
    """

    role: str
    images: int
    example: str
    told_by: tuple[str, ...]
    pattern: str | None = None


@dataclass(frozen=True)
class FrameSet:
    """The frames of one folder, read one at a time while iterating.

    Attributes
    ----------
    frames : callable
        Begins to read, and gives each frame once.
    classes : tuple of str or None
        The layout's own list of classes, in its order.
    count : int or None
        Number of frames, None where only reading tells.
    notes : callable
        Gives sentences for people: what was recognised, and what was read as something
        else. Complete when all frames have been read.
    streams : tuple of StreamFacts
        The images of the folder; empty where the layout names each file.
    texts : callable or None
        Gives the files that are read besides those of `FrameSource`: labels, lists of
        classes, calibrations. None: nothing tells which.
    parts : mapping of str to int
        Files that list frames, each with the number of them.
    """

    layout: str
    frames: Callable[[], Iterator[FrameSource]]
    classes: tuple[str, ...] | None = None
    count: int | None = None
    unmatched: tuple[Unmatched, ...] = ()
    notes: Callable[[], tuple[str, ...]] = tuple
    streams: tuple[StreamFacts, ...] = ()
    texts: Callable[[], Iterable[Path]] | None = None
    parts: Mapping[str, int] = field(default_factory=dict)

    def __iter__(self) -> Iterator[FrameSource]:
        return self.frames()


def band_folders(root: Path) -> list[Path]:
    """Labels of distance bands next to ``labels``, which hold the same boxes again."""
    if not any((root / name).is_dir() for name in ("labels", "Annotations")):
        return []
    return [path for path in root.iterdir() if is_band(path.name)]


def manifests_below(folder: Path) -> list[str]:
    """Every ``manifest.jsonl`` in a folder and its sub-folders, relative to it."""
    lines = walk(folder, (".jsonl",))
    return [name for name in lines if last_name(name) == MANIFEST_NAME]


def walk(
    root: Path, suffixes: Collection[str] | None, skip: Collection[Path] = ()
) -> Iterator[str]:
    """Files with one of the suffixes, relative to the folder, in the order of names.

    None: all files.

    Hidden files and folders, ``__MACOSX`` and the folders of `skip` are left out;
    links to folders are not followed, so that the walk ends.
    """
    skipped = {path.resolve() for path in skip}
    for folder, folders, files in os.walk(root):
        folders[:] = sorted(
            name
            for name in folders
            if not is_hidden(name) and (Path(folder) / name).resolve() not in skipped
        )
        below = Path(folder).relative_to(root).as_posix()
        prefix = "" if below == "." else f"{below}/"
        for name in sorted(files):
            fits = suffixes is None or split_name(name)[1].lower() in suffixes
            if fits and not is_hidden(name):
                yield prefix + name


def real_paths(*paths: Path) -> tuple[Path, ...]:
    """The paths with all symbolic links followed, for `is_inside`."""
    return tuple(Path(os.path.realpath(path)) for path in paths)


def is_inside(path: Path, folders: Iterable[Path]) -> bool:
    """Whether a file, with all links followed, is or lies in one of `real_paths`."""
    try:
        real = Path(os.path.realpath(path))
    except ValueError:  # no file can have such a name
        return False
    return any(real.is_relative_to(folder) for folder in folders)


def common_end(some: Sequence[str], others: Sequence[str]) -> int:
    """How many names at the end of two paths are the same."""
    pairs = zip(reversed(some), reversed(others), strict=False)
    return next(
        (place for place, (name, other) in enumerate(pairs) if name != other),
        min(len(some), len(others)),
    )


LOCAL_FILES: Final = "/data/local-files/?d="
"""How Label Studio begins the address of a file of its machine."""

_ADDRESS: Final = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:/*|/+")
"""The beginning of an address, of a path on a drive, or of an absolute path."""


def relative_path(name: str) -> tuple[str, bool]:
    """A path without root, drive, address and ``..``; whether it had any of these."""
    path = name
    if LOCAL_FILES in path:
        path = unquote(path.partition(LOCAL_FILES)[2])
    path = path.replace("\\", "/")
    begins = _ADDRESS.match(path)
    parts = path[begins.end() if begins else 0 :].split("/")
    kept = [part for part in parts if part not in ("", ".", "..")]
    is_elsewhere = path != name.replace("\\", "/") or bool(begins) or ".." in parts
    return "/".join(kept), is_elsewhere


def name_of(source: Path) -> str:
    """The name of a folder or a file, for messages: of ``.``, too, which has none."""
    return source.name or source.resolve().name or str(source)


def frame_key(name: str) -> str:
    """The key of the frame a file belongs to, from its path inside the folder.

    The suffix goes (only the last: ``a.b.png`` is ``a.b``), and so do folders that say
    what kind of files they hold: ``train/images/7.png`` and ``train/labels/7.txt`` are
    both ``train/7``. Accents are composed, since some systems store them apart. Raises
    `LayoutError`: it is the path of a folder, such as ``/``.
    """
    folders, _, last = unicodedata.normalize("NFC", name).rpartition("/")
    if last in ("", "."):
        path = PurePosixPath(name)
        if not path.name:
            raise LayoutError(f"expected the name of a file, found {name[:40]!r}")
        folders, _, last = str(path).rpartition("/")
    return f"{key_of_folders(folders)}{split_name(last)[0]}"


def split_name(name: str) -> tuple[str, str]:
    """The stem and the suffix of a file's name: ``a.b`` and ``.png``.

    Without a path, since one for each of a hundred thousand files takes seconds.
    """
    stem, dot, suffix = name.rpartition(".")
    return (stem, f"{dot}{suffix}") if stem else (name, "")


@lru_cache(4096)
def key_of_folders(folders: str) -> str:
    """The beginning of a frame's key, from the path of a file's folder."""
    parts = PurePosixPath(folders).parts
    kept = [part for part in parts if part.lower() not in FOLDER_WORDS]
    return "".join(f"{part}/" for part in kept)


_LOOKED_AT: Final = 4096
"""Bytes of a text that tell what it is."""

_FEWEST_COLUMNS: Final = 4


def is_label(root: Path, name: str) -> bool:
    """Whether a ``.txt`` or ``.xml`` file of a folder may hold boxes.

    By its name (`holds_boxes`), and a text by its content (`has_rows`), too.
    """
    is_text = name.lower().endswith(".txt")
    return holds_boxes(name) and (not is_text or has_rows(root / name))


def has_rows(path: Path) -> bool:
    """Whether a text file may hold boxes, by its content.

    It may if it is empty, or its first row has four columns or more, most of which are
    numbers. Notes and lists of names do not. A file that cannot be read may: its frame
    is to have the error. So may rows with a mistake in them.
    """
    try:
        with open_regular(path) as file:
            text = file.read(_LOOKED_AT).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError):
        return True
    first = next(filter(None, map(str.split, text.splitlines())), None)
    if first is None:
        return True
    numbers = sum(map(is_number, first))
    return len(first) >= _FEWEST_COLUMNS and 2 * numbers > len(first)


def is_number(word: str) -> bool:
    """Whether `float` reads a word: so readers tell rows of boxes from other text."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def last_name(key: str) -> str:
    """The part of a key after its last slash."""
    return key.rpartition("/")[2]


def annotated(
    frame: FrameSource, read: Callable[[], Mapping[str, object]]
) -> FrameSource:
    """A frame with the annotation that `read` returns, or with its error.

    Parameters
    ----------
    frame : FrameSource
        Keys of its annotation stay if those that are read do not replace them.
    read : callable
        Reads the frame's label file. A `FilterError` becomes the frame's problem, so
        that other frames are still read.
    """
    try:
        annotation = {**(frame.annotation or {}), **read()}
    except FilterError as problem:
        return replace(frame, annotation=None, problem=problem)
    return replace(frame, annotation=annotation)


def open_regular(path: Path) -> BinaryIO:
    """Open a file of a folder to read it.

    A folder from somebody else may have a pipe in place of a file, for which reading
    would wait without end, or a link to a device that never ends. Raises `OSError`: it
    cannot be opened, or is not a regular file.
    """
    return os.fdopen(_descriptor(path)[0], "rb")


def _descriptor(path: Path) -> tuple[int, int]:
    """The descriptor of an open regular file, and its size."""
    # Not blocking, so that it does not wait for a program that writes into a pipe.
    descriptor = os.open(path, _TO_READ)
    try:
        state = os.fstat(descriptor)
        if not stat.S_ISREG(state.st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor, state.st_size


@contextmanager
def opening_file(path: Path, what: str) -> Iterator[None]:
    """Makes a failure to open or read a file of a frame a `LayoutError` about it."""
    try:
        yield
    except OSError as exc:
        raise LayoutError(
            f"{what}: {path.name} cannot be read: {exc.strerror}"
        ) from exc


def read_file(path: Path, what: str) -> bytes:
    """The content of a file of a frame; `what` is its role, for errors.

    Raises `LayoutError`: it cannot be read; names the file, never its folder.
    """
    with opening_file(path, what), open_regular(path) as file:
        return file.read()


def read_label_text(path: Path, name: str) -> str:
    """A label file's text.

    Raises `LayoutError`: not there, too large, or not UTF-8; names the file, never its
    folder.
    """
    try:
        content = read_label_bytes(path, name)
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as exc:
        raise LayoutError(
            f"{name}: expected UTF-8 text, found byte {exc.object[exc.start]:#04x} "
            f"at position {exc.start}"
        ) from exc


def read_label_bytes(path: Path, name: str, limit: int = MAX_LABEL_BYTES) -> bytes:
    """A label file's bytes; `name` is its name in errors.

    Raises `LayoutError`: it cannot be read, or is longer than `limit`.
    """
    content = b""
    try:
        # Without a file object, which takes several times as long as a label file.
        descriptor, size = _descriptor(path)
        try:
            # It may grow in the meantime.
            while part := os.read(descriptor, min(size, limit) + 1):
                content += part
                if len(content) > limit:
                    break
        finally:
            os.close(descriptor)
    except OSError as exc:
        raise LayoutError(f"{name}: cannot be read: {exc.strerror}") from exc
    if len(content) > limit:
        raise LayoutError(f"{name}: expected at most {limit} bytes, found more")
    return content


def read_columns(words: Sequence[str], at: str) -> list[float]:
    """The numbers in `words`; `at` is their place, for errors.

    Raises `LayoutError`: a word is no finite number.
    """
    numbers = []
    for word in words:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise LayoutError(f"{at}: expected a finite number, found {word[:40]!r}")
        numbers.append(number)
    return numbers


def json_object(content: bytes, at: str, *, halves: bool = False) -> dict[str, object]:
    """The JSON object that these bytes are; `at` is their place, for errors.

    With `halves`, those of surrogate pairs pass (`read_json`). Raises `LayoutError`:
    they are no JSON, or something else than an object.
    """
    try:
        value = read_json(content, halves=halves)
    except JsonError as exc:
        raise LayoutError(f"{at}: {exc.detail}") from exc
    if not isinstance(value, dict):
        raise LayoutError(f"{at}: expected one JSON object, found {shown(value)}")
    return value


def is_hidden(name: str) -> bool:
    """Whether readers skip a file or folder of this name, and its content.

    These names begin with a dot, or are those that macOS puts into archives.
    """
    return name.startswith(".") or name == "__MACOSX"
