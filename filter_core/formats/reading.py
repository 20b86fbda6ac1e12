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
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import BinaryIO, Final, NamedTuple

from filter_core.errors import FilterError, JsonError, LayoutError
from filter_core.images.header import read_image_size
from filter_core.json_text import read_json

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
folder.js)."""

IMAGE_FOLDER_WORDS: Final = ("images", "image", "img", "jpegimages")

FOLDER_WORDS: Final = frozenset({*IMAGE_FOLDER_WORDS, "labels", "label", "annotations"})
"""Names of folders that describe the kind of files, and are not part of a key."""

_BAND: Final = re.compile(r"label\d+", re.IGNORECASE)


@dataclass(frozen=True)
class FrameSource:
    """The files and the annotation of one frame of a folder.

    Attributes
    ----------
    key : str
        Names the frame; may contain ``/``.
    annotation : mapping or None
        As `parse_annotation` takes it; None if there is a `problem`.
    image, segmentation : Path or None
    others : mapping of str to Path
        ``depth``, ``instances``, ``lidar``, ``radar``, ``ignore_mask`` where given.
    problem : FilterError or None
        Why the frame cannot be used; other frames are still read.
    label : str or None
        The label file that belongs to an image of the same name, relative to the folder
        of the labels; None where the layout names images otherwise.
    shown : mapping of str to str
        Keys of a configuration, such as ``palette``, with the values that the images of
        the whole recording show; a configuration's own values win.
    """

    key: str
    annotation: Mapping[str, object] | None
    image: Path | None = None
    segmentation: Path | None = None
    others: Mapping[str, Path] = field(default_factory=dict)
    problem: FilterError | None = None
    label: str | None = None
    shown: Mapping[str, str] = field(default_factory=dict)


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
    """A file that belongs to no frame.

    Attributes
    ----------
    path : str
        Relative to the folder.
    why : str
    """

    path: str
    why: str


_NAME: Final = re.compile(r"\S*[/.\[\d]\S*")
"""Words of a reason that may differ in other reasons of its kind."""


def kind_of_reason(why: str) -> str:
    """A reason of `Unmatched` without names and numbers: equal for those of a kind."""
    return _NAME.sub("...", why)


class StreamFacts(NamedTuple):
    """Images of one stream that have one role.

    Attributes
    ----------
    role : str
        ``image`` for the camera's pictures.
    images : int
        How many there are.
    example : str
        The first of them, relative to the folder in which it was found.
    told_by : tuple of str
        What told the role: ``name``, ``pixels``, ``description``, ``manifest``; empty
        for pictures of which nothing says that they are anything else.
    """

    role: str
    images: int
    example: str
    told_by: tuple[str, ...]


@dataclass(frozen=True)
class FrameSet:
    """The frames of one folder, read one at a time while iterating.

    Attributes
    ----------
    layout : str
    frames : callable
        Begins to read, and gives each frame once.
    classes : tuple of str or None
        The layout's own list of classes, in its order.
    count : int or None
        Number of frames, None where only reading tells.
    unmatched : tuple of Unmatched
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


@dataclass(frozen=True)
class FrameFileNames:
    """The names of one frame's files, each relative to the folder it was found in.

    Attributes
    ----------
    key : str
    label : str
    image : str or None
    map : str or None
        The town, where a list of the frames' keys says so.
    files : mapping of str to Path
        The auxiliary images, such as ``segmentation``, by role.
    """

    key: str
    label: str
    image: str | None = None
    map: str | None = None
    files: Mapping[str, Path] = field(default_factory=dict)


def band_folders(root: Path) -> list[Path]:
    """Labels of distance bands next to ``labels``, which hold the same boxes again."""
    if not any((root / name).is_dir() for name in ("labels", "Annotations")):
        return []
    return [path for path in root.iterdir() if _BAND.fullmatch(path.name)]


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


def match(
    labels: Iterable[str],
    images: Iterable[str],
    image_named: Callable[[str], str | None] | None = None,
) -> tuple[list[FrameFileNames], tuple[Unmatched, ...]]:
    """One entry per label file, in the order of the keys, and all that is left over.

    `image_named` gives the path of the image that a label file itself names, or None;
    it is asked about labels that no image is called like.
    """
    label_index = FileIndex(labels)
    image_index = FileIndex(images)
    frames = []
    for key, label in label_index:
        # Images may be in a flat folder although labels have sub-folders, but only a
        # name that occurs once on both sides identifies a frame.
        alone = label_index.is_only_base(key)
        image = image_index.take(key, by_base=alone)
        if image is None and image_named and (name := image_named(label)):
            image = image_index.take_named(name)
        frames.append(FrameFileNames(key, label, image))
    unmatched = (
        *label_index.unmatched,
        *image_index.left_over("no label file for this image"),
    )
    return frames, unmatched


class FileIndex:
    """Files by frame key; a second file of the same key is used only if it is named.

    `key_of` returns the key of a file; by default `frame_key`.
    """

    def __init__(
        self, files: Iterable[str], key_of: Callable[[str], str] | None = None
    ) -> None:
        key_of = key_of or frame_key
        self._by_key: dict[str, str] = {}
        self._alike: dict[str, list[str]] = {}
        for file in files:
            key = key_of(file)
            first = self._by_key.setdefault(key, file)
            if first != file:
                self._alike.setdefault(key, [first]).append(file)
        self._unused = dict.fromkeys(self._by_key.values())
        self._later = {
            file: first for first, *later in self._alike.values() for file in later
        }
        self._by_base: dict[str, list[str]] = {}
        for key in self._by_key:
            self._by_base.setdefault(last_name(key), []).append(key)

    def __iter__(self) -> Iterator[tuple[str, str]]:
        return iter(sorted(self._by_key.items()))

    def __len__(self) -> int:
        return len(self._by_key)

    @property
    def unmatched(self) -> list[Unmatched]:
        """Files that share the key of another, which is used."""
        return [
            Unmatched(file, f"same frame as {first}, which is used")
            for file, first in self._later.items()
        ]

    def is_only_base(self, key: str) -> bool:
        """Whether no other key ends in the same name."""
        return len(self._by_base.get(last_name(key), ())) == 1

    def take(self, key: str, *, by_base: bool = False) -> str | None:
        """The file of a frame; `by_base`: else the only one with its last name."""
        if key not in self._by_key and by_base and self.is_only_base(key):
            (key,) = self._by_base[last_name(key)]
        return self._use(self._by_key.get(key))

    def take_named(
        self, name: str, *, least: int = 1, same_suffix: bool = False
    ) -> str | None:
        """The file whose path has the longest end in common with `name`.

        None if several have, or none has at least its `least` last parts. Of files that
        differ in nothing but the suffix it is the one with that of `name`, or the first
        if none has it; with `same_suffix` only the former.
        """
        key = frame_key(name)
        keys = self._by_base.get(last_name(key), [])
        if key not in self._by_key and keys:
            parts = key.split("/")
            common = [_common_end(one.split("/"), parts) for one in keys]
            longest = max(common)
            keys = [one for one, n in zip(keys, common, strict=True) if n == longest]
            if len(keys) > 1 or longest < least:
                return None
            (key,) = keys
        if key not in self._by_key:
            return None
        files = self._alike.get(key, [self._by_key[key]])
        suffix = PurePosixPath(name).suffix.lower()
        alike = [file for file in files if file.lower().endswith(suffix)]
        if not alike:
            return None if same_suffix else self._use(files[0])
        return self._use(alike[0])

    def _use(self, file: str | None) -> str | None:
        if file is not None:
            self._unused.pop(file, None)
            self._later.pop(file, None)
        return file

    def left_over(self, why: str) -> list[Unmatched]:
        """Files that belong to no frame, and those that share a key."""
        unused = [Unmatched(file, why) for file in self._unused]
        return [*self.unmatched, *unused]


def _common_end(some: Sequence[str], others: Sequence[str]) -> int:
    """How many names at the end of two paths are the same."""
    pairs = zip(reversed(some), reversed(others), strict=False)
    return next(
        (place for place, (one, other) in enumerate(pairs) if one != other),
        min(len(some), len(others)),
    )


def name_of(source: Path) -> str:
    """The name of a folder or a file, for messages: of ``.``, too, which has none."""
    return source.name or source.resolve().name or str(source)


def frame_key(name: str) -> str:
    """The key of the frame a file belongs to, from its path inside the folder.

    The suffix goes (only the last: ``a.b.png`` is ``a.b``), and so do folders that say
    what kind of files they hold: ``train/images/7.png`` and ``train/labels/7.txt`` are
    both ``train/7``. Accents are composed, since some systems store them apart.

    Raises
    ------
    LayoutError
        It is the path of a folder, such as ``/``.
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


_CLASS_LISTS: Final = frozenset({"classes.txt", "labels.txt"})

_TEXTS_AT_THE_TOP: Final = frozenset(
    {
        "labelmap.txt",
        "readme.txt",
        "requirements.txt",
        "train.txt",
        "val.txt",
        "test.txt",
    }
)
"""Lists of files and notes in a dataset's top folder; in sub-folders such a file is a
frame's."""


def holds_boxes(name: str) -> bool:
    """Whether a label file, relative to its dataset, holds boxes, by its name.

    Lists of classes, lists of files and notes hold none.
    """
    folder, _, base = name.lower().rpartition("/")
    if folder.split("/")[0] == "imagesets":
        return False
    return base not in _CLASS_LISTS and (folder or base) not in _TEXTS_AT_THE_TOP


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
    """Whether a text file may hold boxes, by its content: it is empty, or its first row
    has four columns or more, most of which are numbers.

    Notes and lists of names do not. A file that cannot be read may: its frame is to
    have the error. So may rows with a mistake in them.
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
    """Whether a word of a text is a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def last_name(key: str) -> str:
    """The part of a key after its last slash."""
    return key.rpartition("/")[2]


def with_keys(
    root: Path, frames: Sequence[FrameFileNames], images: str = ""
) -> Sequence[FrameFileNames]:
    """Frames under the keys that ``frames.jsonl`` gives them, with their maps.

    Parameters
    ----------
    root : Path
        The folder that may have the list.
    frames : sequence of FrameFileNames
    images : str
        The folder of the images, where the keys of `frames` are relative to it.

    Returns
    -------
    sequence of FrameFileNames
        In the order of the keys; as they were if there is no list.

    Raises
    ------
    LayoutError
        The list names a file or a key twice, or a line of it cannot be read.
    """
    path = root / KEYS_NAME
    if not path.is_file():
        return frames
    named = _read(path)
    renamed = (
        replace(one, key=found[0], map=found[1]) if found else one
        for one in frames
        for found in [named.get(f"{images}{one.key}")]
    )
    return sorted(renamed, key=lambda one: one.key)


def frame_of(files: FrameFileNames, images: Path) -> FrameSource:
    """A frame from the names of its files; its label file is not read yet."""
    others = dict(files.files)
    segmentation = others.pop("segmentation", None)
    return FrameSource(
        key=files.key,
        annotation=None if files.map is None else {"map": files.map},
        image=images / files.image if files.image else None,
        segmentation=segmentation,
        others=others,
        label=files.label,
    )


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

    Returns
    -------
    FrameSource
    """
    try:
        annotation = {**(frame.annotation or {}), **read()}
    except FilterError as problem:
        return replace(frame, annotation=None, problem=problem)
    return replace(frame, annotation=annotation)


def open_regular(path: Path) -> BinaryIO:
    """Open a file of a folder to read it.

    A folder from somebody else may have a pipe in place of a file, for which reading
    would wait without end, or a link to a device that never ends.

    Raises
    ------
    OSError
        It cannot be opened, or is not a regular file.
    """
    # Not blocking, so that it does not wait for a program that writes into a pipe.
    descriptor = os.open(path, _TO_READ)
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
    except BaseException:
        os.close(descriptor)
        raise
    return os.fdopen(descriptor, "rb")


def read_label_text(path: Path, name: str) -> str:
    """A label file's text.

    Raises
    ------
    LayoutError
        Not there, too large, or not UTF-8; names the file, never its folder.
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

    Raises
    ------
    LayoutError
        It cannot be read, or is longer than `limit`.
    """
    try:
        with open_regular(path) as file:
            # It may grow in the meantime.
            content = file.read(limit + 1)
    except OSError as exc:
        raise LayoutError(f"{name}: cannot be read: {exc.strerror}") from exc
    if len(content) > limit:
        raise LayoutError(f"{name}: expected at most {limit} bytes, found more")
    return content


def read_columns(words: Sequence[str], at: str) -> list[float]:
    """The numbers in `words`; `at` is their place, for errors.

    Raises
    ------
    LayoutError
        A word is no finite number.
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


def is_hidden(name: str) -> bool:
    """Whether readers skip a file or folder of this name, and its content.

    These names begin with a dot, or are those that macOS puts into archives.
    """
    return name.startswith(".") or name == "__MACOSX"


def _read(path: Path) -> dict[str, tuple[str, str | None]]:
    named: dict[str, tuple[str, str | None]] = {}
    keys: set[str] = set()
    for at, line in _lines(path):
        file, key, town = line.get("file"), line.get("key"), line.get("map")
        if not isinstance(file, str) or not isinstance(key, str):
            raise LayoutError(f"{at}: expected file and key, found {str(line)[:60]}")
        if not 0 < len(key) <= MAX_KEY or not isinstance(town, (str, type(None))):
            raise LayoutError(f"{at}: expected a key and a map, found {str(line)[:60]}")
        name = frame_key(file)
        if name in named or key in keys:
            raise LayoutError(
                f"{at}: expected each file and key once, found {str(line)[:60]} again"
            )
        keys.add(key)
        named[name] = key, town
    return named


def _lines(path: Path) -> Iterator[tuple[str, dict[str, object]]]:
    with open_regular(path) as file:
        for number, line in enumerate(
            iter(lambda: file.readline(MAX_LABEL_BYTES), b"")
        ):
            at = f"{path.name}, line {number + 1}"
            try:
                value = read_json(line)
            except JsonError as exc:
                raise LayoutError(f"{at}: {exc.detail}") from exc
            if not isinstance(value, dict):
                raise LayoutError(f"{at}: expected an object")
            yield at, value
