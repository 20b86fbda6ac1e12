"""Which files of a folder belong together: the same name in parallel folders."""

from __future__ import annotations

import os
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from filter_core.formats.reading import Unmatched

IMAGE_SUFFIXES: Final = (".png", ".jpg", ".jpeg")

_FOLDER_WORDS: Final = frozenset(
    {"images", "image", "img", "jpegimages", "labels", "label", "annotations"}
)
"""Names of folders that say what their files are, not which frame they belong to."""


@dataclass(frozen=True)
class FrameFiles:
    """The files of one frame, each relative to the folder it was searched in.

    `map` is the town, where a list of the frames' keys says so.
    """

    key: str
    label: str
    image: str | None = None
    segmentation: str | None = None
    map: str | None = None


def walk(
    root: Path, suffixes: Collection[str], skip: Collection[Path] = ()
) -> Iterator[str]:
    """Files with one of the suffixes, relative to the folder, in the order of names.

    Hidden files and folders, ``__MACOSX`` and the folders of `skip` are left out;
    links to folders are not followed, so that the walk ends.
    """
    skipped = {path.resolve() for path in skip}
    for folder, folders, files in os.walk(root):
        folders[:] = sorted(
            name
            for name in folders
            if not _is_hidden(name) and (Path(folder) / name).resolve() not in skipped
        )
        for name in sorted(files):
            if not _is_hidden(name) and Path(name).suffix.lower() in suffixes:
                yield (Path(folder) / name).relative_to(root).as_posix()


def frame_key(name: str) -> str:
    """The key of the frame a file belongs to, from its path inside the folder.

    The suffix goes (only the last: ``a.b.png`` is ``a.b``), and so do folders that say
    what kind of files they hold: ``train/images/7.png`` and ``train/labels/7.txt`` are
    both ``train/7``. Accents are composed, since some systems store them apart.
    """
    path = PurePosixPath(unicodedata.normalize("NFC", name)).with_suffix("")
    folders = [part for part in path.parts[:-1] if part.lower() not in _FOLDER_WORDS]
    return "/".join([*folders, path.name])


class FileIndex:
    """Files by frame key; a second file of the same key is noted, not taken."""

    def __init__(self, files: Iterable[str]) -> None:
        self._by_key: dict[str, str] = {}
        self._unused: dict[str, str] = {}
        self.unmatched: list[Unmatched] = []
        for file in files:
            key = frame_key(file)
            first = self._by_key.setdefault(key, file)
            if first != file:
                self.unmatched.append(
                    Unmatched(file, f"same frame as {first}, which is used")
                )
        self._unused.update(self._by_key)
        bases = Counter(map(_base, self._by_key))
        self._by_base = {
            _base(key): key for key in self._by_key if bases[_base(key)] == 1
        }

    def __iter__(self) -> Iterator[tuple[str, str]]:
        return iter(sorted(self._by_key.items()))

    def __len__(self) -> int:
        return len(self._by_key)

    def is_only_base(self, key: str) -> bool:
        """Whether no other key ends in the same name."""
        return _base(key) in self._by_base

    def take(self, key: str, *, by_base: bool = False) -> str | None:
        """The file of a frame; `by_base`: else the only one with its last name."""
        if key not in self._by_key and by_base:
            key = self._by_base.get(_base(key), key)
        self._unused.pop(key, None)
        return self._by_key.get(key)

    def left_over(self, why: str) -> list[Unmatched]:
        """What nobody took, and what could not be told apart."""
        unused = [Unmatched(file, why) for file in self._unused.values()]
        return [*self.unmatched, *unused]


def match(
    labels: Iterable[str],
    images: Iterable[str],
    segmentations: Iterable[str] = (),
) -> tuple[list[FrameFiles], tuple[Unmatched, ...]]:
    """One entry per label file, in the order of the keys, and all that is left over."""
    label_index = FileIndex(labels)
    image_index, tag_index = FileIndex(images), FileIndex(segmentations)
    frames = []
    for key, label in label_index:
        # Segmentations often lie in a flat folder beside labels in sub-folders, but
        # only a name that occurs once on both sides can be told by its end.
        alone = label_index.is_only_base(key)
        image = image_index.take(key, by_base=alone)
        tags = tag_index.take(key, by_base=alone)
        frames.append(FrameFiles(key, label, image, tags))
    unmatched = (
        *label_index.unmatched,
        *image_index.left_over("no label file for this image"),
        *tag_index.left_over("no label file for this segmentation"),
    )
    return frames, unmatched


def _is_hidden(name: str) -> bool:
    return name.startswith(".") or name == "__MACOSX"


def _base(key: str) -> str:
    return key.rpartition("/")[2]
