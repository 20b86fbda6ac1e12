"""The files of a folder: which of them frames use, splits, cameras, and the rest."""

from __future__ import annotations

import os
import zlib
from array import array
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    KEYS_NAME,
    RECORDING_NAME,
    TEXT_SUFFIXES,
    FrameSet,
    FrameSource,
    is_hidden,
    kind_of_reason,
    open_regular,
    split_name,
)
from filter_core.formats.splits import (
    Split,
    folders_of_parts,
    lists_below,
    part_of_folder,
)
from filter_core.formats.tables.patterns import FilePatterns
from filter_core.formats.words import is_band
from filter_core.inspection.listing import Listed, Listing

_ALIKE: Final = 0.5
"""Share of names that two folders have in common, at least, if they are of cameras."""

_MOST_FOLDERS: Final = 4096
"""Folders of pictures that are compared."""


class Cameras(NamedTuple):
    """Folders whose pictures have the same names, and the frames of the first of them.

    They are those of cameras at the same instants, or of runs that count alike.
    """

    folders: tuple[str, ...]
    frames: int


class FileUse:
    """The files that frames use, relative to the folder.

    Those that `files` of the description ignore are not read. `outside` counts files of
    frames that are not in the folder, `splits` frames by the folders whose names are
    those of parts.
    """

    def __init__(self, root: Path, files: FilePatterns) -> None:
        self.root, self.files = root, files
        self.outside = 0
        self.splits: Counter[str] = Counter()
        self._used = array("q")
        self._by_folder: dict[str, array[int]] = {}
        self._prefix = f"{str(root).rstrip(os.sep)}{os.sep}"

    def relative(self, path: Path) -> str | None:
        """A path relative to the folder; None if it is elsewhere."""
        text = str(path)
        if self._prefix == f".{os.sep}" and not path.is_absolute():
            return path.as_posix()
        if not text.startswith(self._prefix):
            return None
        return text[len(self._prefix) :].replace(os.sep, "/")

    def add(self, frame: FrameSource) -> None:
        """The files of one more frame."""
        for path in (frame.image, frame.segmentation, *frame.others.values()):
            if path is not None:
                self.add_file(path)
        name = self.relative(frame.image) if frame.image else frame.label
        if name is None:
            return
        folder, _, last = name.rpartition("/")
        if part := part_of_folder(folder):
            self.splits[part] += 1
        names = self._by_folder.get(folder)
        if names is None and len(self._by_folder) < _MOST_FOLDERS:
            names = self._by_folder[folder] = array("I")
        if names is not None:
            names.append(zlib.crc32(split_name(last)[0].encode("utf-8", "replace")))

    def add_file(self, path: Path) -> None:
        """One more file that is read."""
        name = self.relative(path)
        if name is None:
            self.outside += 1
        else:
            self._used.append(hash(name))

    def is_used(self) -> Callable[[str], bool]:
        """Tells of a file whether it is used, by the hash of its name."""
        used = array("q", np.unique(np.array(self._used)).tobytes())

        def tells(name: str) -> bool:
            place = bisect_left(used, hash(name))
            return place < len(used) and used[place] == hash(name)

        return tells

    def cameras(self) -> tuple[Cameras, ...]:
        """Folders that hold pictures of the same names."""
        groups: dict[int, list[str]] = {}
        for folder, names in self._by_folder.items():
            # Folders with most of their names in common share the smallest number.
            groups.setdefault(min(names), []).append(folder)
        return tuple(
            Cameras(alike, len(set(self._by_folder[alike[0]])))
            for folders in groups.values()
            if len(alike := self._alike(folders)) > 1
        )

    def _alike(self, folders: list[str]) -> tuple[str, ...]:
        first = set(self._by_folder[folders[0]])
        parts = {part_of_folder(folder) for folder in folders}
        return tuple(
            folder
            for folder in folders
            if len(parts) == 1
            and len(first.intersection(self._by_folder[folder]))
            >= _ALIKE * len(first.union(self._by_folder[folder]))
        )


def found_splits(frames: FrameSet, use: FileUse) -> tuple[Split, ...]:
    """The parts of a recording, as its folders, lists and files of labels say."""
    are_parts = folders_of_parts(use.splits)
    folders = [
        Split(name, "folder", count)
        for name, count in use.splits.items()
        if name in are_parts
    ]
    is_used = use.is_used()
    labels = [Split(name, "labels", count) for name, count in frames.parts.items()]
    lists = (
        Split(name, "list", _count_lines(use.root / name))
        for name in lists_below(use.root)
        if not is_used(name)
    )
    return (*folders, *(labels if len(labels) > 1 else ()), *lists)


def _count_lines(path: Path) -> int:
    try:
        with open_regular(path) as lines:
            return sum(1 for line in lines if line.strip())
    except OSError:
        return 0


def unused_files(
    frames: FrameSet, use: FileUse, splits: Collection[Split]
) -> tuple[tuple[Listed, ...], tuple[Listed, ...]]:
    """Images and labels of a folder that belong to no frame; and its other files.

    The others are those that are not read, such as notes.
    """
    left_over, not_read = Listing(), Listing()
    for file in frames.unmatched:
        left_over.add(kind_of_reason(file.why), file.path, file.why)
    if not use.root.is_dir():
        return left_over.listed(), not_read.listed()
    for path in frames.texts() if frames.texts else ():
        use.add_file(path)
    our_names = {RECORDING_NAME, KEYS_NAME, *(split.name for split in splits)}
    unmatched = {file.path for file in frames.unmatched}
    lasts = {path.rpartition("/")[2] for path in unmatched}
    is_used = use.is_used()
    for name in _all_files(use.root):
        # Some paths are relative to a folder of their own.
        parts = name.split("/")
        is_listed = parts[-1] in lasts and any(
            "/".join(parts[start:]) in unmatched for start in range(len(parts))
        )
        if is_listed or is_used(name) or name in our_names:
            continue
        why = _IGNORED if use.files.ignores(name) else _why_not_read(name, frames)
        if why is not None:
            not_read.add(why, name, why)
    return left_over.listed(), not_read.listed()


_IGNORED: Final = "`files.ignore` of the description leaves it out"


def _all_files(root: Path) -> Iterator[str]:
    """All files of a folder; of a hidden folder only its name."""
    for folder, folders, files in os.walk(root):
        below = os.path.relpath(folder, root).replace(os.sep, "/")
        prefix = "" if below == "." else f"{below}/"
        hidden = [name for name in folders if is_hidden(name)]
        folders[:] = sorted(set(folders).difference(hidden))
        yield from (f"{prefix}{name}/" for name in sorted(hidden))
        yield from (f"{prefix}{name}" for name in sorted(files))


def _why_not_read(name: str, frames: FrameSet) -> str | None:
    """Why no reader opens a file; None if it is not known whether one does."""
    *folders, last = name.split("/")
    if is_hidden(last or folders[-1]):
        return "hidden"
    suffix = split_name(last)[1].lower()
    if not frames.layout and suffix in (*IMAGE_SUFFIXES, *TEXT_SUFFIXES):
        return "not read, since the folder cannot be read"
    if suffix in IMAGE_SUFFIXES:
        if frames.layout == "manifest":
            return "no line of the manifest names it"
        return f"layout {frames.layout} has no pictures in this folder"
    if suffix not in TEXT_SUFFIXES:
        ending = f"*{suffix}" if suffix else "files without an ending"
        return f"no reader opens {ending}"
    if frames.texts is None:
        return None
    if any(map(is_band, folders)):
        return "labels of a narrower distance band, whose boxes the widest has, too"
    return f"neither a label nor a list that layout {frames.layout} reads"
