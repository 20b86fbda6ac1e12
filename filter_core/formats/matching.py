"""Which files belong to one frame: those of the same name in parallel folders.

Keys that are no valid file names are read from the list in an export
(``frames.jsonl``). A recording may have a million files, so their names are held in a
few dozen bytes each.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Final

import numpy as np

from filter_core.errors import JsonError, LayoutError
from filter_core.formats.reading import (
    KEYS_NAME,
    MAX_KEY,
    MAX_LABEL_BYTES,
    BoxOrigin,
    FrameSource,
    Unmatched,
    common_end,
    frame_key,
    last_name,
    open_regular,
)
from filter_core.json_text import read_json


@dataclass(frozen=True)
class FrameFileNames:
    """The names of one frame's files, each relative to the folder it was found in.

    Attributes
    ----------
    map, part : str or None
        The town, and the part of the split, where a list of the frames' keys says so.
    files : mapping of str to Path
        The auxiliary images, such as ``segmentation``, by role.
    """

    key: str
    label: str
    image: str | None = None
    map: str | None = None
    part: str | None = None
    files: Mapping[str, Path] = field(default_factory=dict)


_END: Final = "\0"
"""What separates packed names; no file can have it in its name."""


class FrameNames:
    """The names of the files of many frames, packed as UTF-8."""

    def __init__(self, frames: Iterable[FrameFileNames]) -> None:
        self._text = bytearray()
        self._ends = array("Q", [0])
        for frame in frames:
            names = [
                frame.key,
                frame.label,
                frame.image or "",
                frame.map or "",
                frame.part or "",
            ]
            for role, path in frame.files.items():
                names += (role, str(path))
            text = _END.join([name.replace(_END, "\ufffd") for name in names])
            self._text += text.encode("utf-8", "surrogatepass")
            self._ends.append(len(self._text))

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __iter__(self) -> Iterator[FrameFileNames]:
        for start, end in pairwise(self._ends):
            text = self._text[start:end].decode("utf-8", "surrogatepass")
            key, label, image, town, part, *files = text.split(_END)
            paths = dict(zip(files[::2], map(Path, files[1::2]), strict=True))
            yield FrameFileNames(
                key, label, image or None, town or None, part or None, paths
            )


class PlacesByKey:
    """Places in a sequence by keys that are not kept: 12 bytes for each.

    Different keys of one hash are not told apart: who asks compares the keys. `later`
    are the places of keys that are at an earlier place, too.
    """

    def __init__(self, keys: Iterable[str]) -> None:
        hashes = np.fromiter(map(hash, keys), np.int64)
        order = np.argsort(hashes, kind="stable").astype(np.int32)
        hashes = hashes[order]
        self._hashes = array("q", hashes.tobytes())
        self._order = array("i", order.tobytes())
        self.later = sorted(order[1:][hashes[1:] == hashes[:-1]].tolist())

    def of(self, key: str) -> Sequence[int]:
        """The places of a key, in their order."""
        first = bisect_left(self._hashes, hash(key))
        return self._order[first : bisect_right(self._hashes, hash(key), first)]


def match(
    labels: Iterable[str],
    images: Iterable[str],
    image_named: Callable[[str], str | None] | None = None,
) -> tuple[FrameNames, tuple[Unmatched, ...]]:
    """One entry per label file, in the order of the keys, and all that is left over.

    `image_named` gives the path of the image that a label file itself names, or None;
    it is asked about labels that no image is called like, or several are.
    """
    label_index = FileIndex(labels)
    image_index = FileIndex(images)

    def files_of(key: str, label: str) -> FrameFileNames:
        # Images may be in a flat folder although labels have sub-folders, but only a
        # name that occurs once on both sides identifies a frame.
        alone = label_index.is_only_base(key)
        named = partial(image_named, label) if image_named else None
        image = image_index.take(key, by_base=alone, named=named)
        if image is None and image_named and (name := image_named(label)):
            image = image_index.take_named(name)
        return FrameFileNames(key, label, image)

    frames = FrameNames(files_of(key, label) for key, label in label_index)
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
        self, files: Iterable[str], key_of: Callable[[str], str] = frame_key
    ) -> None:
        self._files = list(files)
        self._key_of = key_of
        self._by_key = PlacesByKey(map(key_of, self._files))
        self._by_base = PlacesByKey(last_name(key_of(file)) for file in self._files)
        self._is_used = bytearray(len(self._files))
        firsts = (
            (place, self._places(key_of(self._files[place]))[0])
            for place in self._by_key.later
        )
        self._first_of = {place: first for place, first in firsts if first != place}
        """Where the first file of the same key is, for all others."""

    def _places(self, key: str) -> list[int]:
        """The places of the files of a key."""
        places = self._by_key.of(key)
        return [place for place in places if self._key_of(self._files[place]) == key]

    def __iter__(self) -> Iterator[tuple[str, str]]:
        places: Sequence[int] = range(len(self._files))
        keys = map(self._key_of, self._files)
        if any(key > other for key, other in pairwise(keys)):
            places = sorted(places, key=lambda place: self._key_of(self._files[place]))
        for place in places:
            if place not in self._first_of:
                yield self._key_of(self._files[place]), self._files[place]

    def __len__(self) -> int:
        return len(self._files) - len(self._first_of)

    @property
    def unmatched(self) -> list[Unmatched]:
        """Files that share the key of another, which is used."""
        return [
            Unmatched(
                self._files[place], f"same frame as {self._files[first]}, which is used"
            )
            for place, first in self._first_of.items()
            if not self._is_used[place]
        ]

    def is_only_base(self, key: str) -> bool:
        """Whether no other key ends in the same name."""
        return len(self._keys_of_base(last_name(key))) == 1

    def take(
        self,
        key: str,
        *,
        by_base: bool = False,
        named: Callable[[], str | None] | None = None,
    ) -> str | None:
        """The file of a frame; `by_base`: else the only one with its last name.

        Of several it is the one with the suffix that `named` gives, or the first.
        """
        places = self._places(key)
        if not places and by_base and self.is_only_base(key):
            places = self._places(self._keys_of_base(last_name(key))[0])
        if len(places) > 1 and named and (name := named()):
            suffix = PurePosixPath(name).suffix.lower()
            alike = [
                place for place in places if self._files[place].lower().endswith(suffix)
            ]
            places = alike or places
        return self._use(places[0]) if places else None

    def take_named(self, name: str, *, least: int = 1) -> str | None:
        """The file whose path has the longest end in common with `name`.

        None if several have, or none has at least its `least` last parts. Of files that
        differ in nothing but the suffix it is the one with that of `name`, or the first
        if none has it.
        """
        key = frame_key(name)
        places = self._places(key)
        if not places:
            keys = self._keys_of_base(last_name(key))
            parts = key.split("/")
            common = [common_end(candidate.split("/"), parts) for candidate in keys]
            longest = max(common, default=0)
            keys = [
                candidate
                for candidate, n in zip(keys, common, strict=True)
                if n == longest
            ]
            if len(keys) != 1 or longest < least:
                return None
            places = self._places(keys[0])
        suffix = PurePosixPath(name).suffix.lower()
        alike = [
            place for place in places if self._files[place].lower().endswith(suffix)
        ]
        return self._use((alike or places)[0])

    def _keys_of_base(self, base: str) -> list[str]:
        """The keys that end in a name."""
        keys = (self._key_of(self._files[place]) for place in self._by_base.of(base))
        return [key for key in dict.fromkeys(keys) if last_name(key) == base]

    def _use(self, place: int) -> str:
        self._is_used[place] = True
        return self._files[place]

    def left_over(self, why: str) -> list[Unmatched]:
        """Files that belong to no frame, and those that share a key."""
        unused = [
            Unmatched(file, why)
            for place, (file, is_used) in enumerate(
                zip(self._files, self._is_used, strict=True)
            )
            if not is_used and place not in self._first_of
        ]
        return [*self.unmatched, *unused]


def named_images(
    names: Sequence[tuple[str | None, str]], images: FileIndex
) -> FrameNames:
    """Frames of a file that lists many, with the images whose paths end most alike.

    `names` has the key of each frame, if the file says it, and its image as
    `relative_path` gives it. Without a key of its own a frame is called by its image.
    """
    bases = Counter(last_name(path) for _, path in names)

    def files_of(key: str | None, path: str) -> FrameFileNames:
        least = 1 if bases[last_name(path)] == 1 else 2
        image = images.take_named(path, least=least)
        own = frame_key(image or path)
        return FrameFileNames(key or own, f"{frame_key(path)}.", image)

    return FrameNames(files_of(key, path) for key, path in names)


def with_keys(
    root: Path, frames: FrameNames, images: str = "", *, ordered: bool = True
) -> FrameNames:
    """Frames under the keys that ``frames.jsonl`` gives them, with their maps.

    As they were if `root` has no such list.

    Parameters
    ----------
    root : Path
        The folder that may have the list.
    images : str
        The folder of the images, where the keys of `frames` are relative to it.
    ordered : bool
        Whether the frames are put into the order of their keys.

    Raises
    ------
    LayoutError
        The list names a file or a key twice, or a line of it cannot be read.
    """
    path = root / KEYS_NAME
    if not path.is_file():
        return frames
    named: dict[str, tuple[str, str | None, str | None]] = {}
    keys: set[str] = set()
    for at, line in _lines(path):
        file, key, town = line.get("file"), line.get("key"), line.get("map")
        text, part = str(line)[:60], line.get("part")
        if not isinstance(file, str) or not isinstance(key, str):
            raise LayoutError(f"{at}: expected file and key, found {text}")
        is_known = isinstance(part, str | None) and 0 < len(key) <= MAX_KEY
        if not is_known or not isinstance(town, str | None):
            raise LayoutError(f"{at}: expected a key and a map, found {text}")
        name = frame_key(file)
        if name in named or key in keys:
            raise LayoutError(
                f"{at}: expected each file and key once, found {text} again"
            )
        keys.add(key)
        named[name] = key, town, part if isinstance(part, str) else None
    renamed = (
        replace(frame, key=key, map=town or frame.map, part=part)
        for frame in frames
        for key, town, part in [
            named.get(f"{images}{frame.key}", (frame.key, frame.map, frame.part))
        ]
    )
    return FrameNames(
        sorted(renamed, key=lambda frame: frame.key) if ordered else renamed
    )


def frame_of(
    files: FrameFileNames, images: Path, labels: Path | None = None
) -> FrameSource:
    """A frame from the names of its files; its label file is not read yet.

    `labels` is the folder of the label files, where each holds the boxes of one frame.
    """
    others = dict(files.files)
    segmentation = others.pop("segmentation", None)
    said = {"map": files.map, "split": files.part}
    return FrameSource(
        key=files.key,
        annotation={name: v for name, v in said.items() if v is not None} or None,
        image=images / files.image if files.image else None,
        segmentation=segmentation,
        others=others,
        label=files.label,
        origin=BoxOrigin(labels / files.label) if labels else None,
    )


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
