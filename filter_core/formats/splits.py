"""Splits: the parts of a recording, such as ``train`` and ``val``, and making others.

A recording tells its own parts by lists of names, by the names of COCO's files, or by
folders; `with_splits` puts the part of each frame into its annotation, as ``split``.
`part_by_shares` makes parts of asked shares, by whole sequences.

References
----------
.. [1] Ultralytics, "Object detection datasets overview" (``data.yaml``),
   https://docs.ultralytics.com/datasets/detect/
.. [2] Everingham and Winn, "The PASCAL VOC2012 development kit", section 4
   (``ImageSets``), http://host.robots.ox.ac.uk/pascal/VOC/voc2012/htmldoc/
"""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypeAlias

from filter_core.config.file import parse_yaml
from filter_core.errors import ConfigError, LayoutError
from filter_core.formats.export import PARTS
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    FrameSet,
    FrameSource,
    common_end,
    last_name,
    read_label_text,
    split_name,
)
from filter_core.formats.words import FOLDER_WORDS, YAML_LISTS, is_camera

SplitSource: TypeAlias = Literal["auto", "none", "lists", "labels", "folders"]
"""What tells the parts of a recording.

``lists``: ``ImageSets/*.txt``, ``train.txt`` and the like in the top folder, and the
lists and folders that a ``data.yaml`` names. ``labels``: the names of COCO's files.
``folders``: names of folders. ``auto``: what frames say themselves, else the first of
these that tells the part of a frame. ``none``: nothing; parts are not read.
"""

_WORDS: Final = r"(train(?:ing|val)?|val(?:id|idation)?|dev|test(?:ing)?)"

_SPLIT: Final = re.compile(rf"{_WORDS}(set)?\d{{0,4}}", re.IGNORECASE)

_ROLES: Final = {"t": "train", "v": "val", "d": "val"}

_SEPARATORS: Final = re.compile(r"[ _.-]+")

_UNION: Final = "trainval"
"""A list of the frames of two others, as VOC and KITTI have it."""

_KITTI_FOLDERS: Final = frozenset({"training", "testing"})
"""Folders of KITTI's layout, whose parts are in ``ImageSets``."""

_FROM_YAML: Final = ("train", "val", "valid", "validation", "test")


class Split(NamedTuple):
    """A part of a recording: its folder, or the file that lists it.

    Its name is that of a ``folder``, of a ``list`` of names, whose lines are counted,
    or of a file of ``labels`` such as COCO's.
    """

    name: str
    told_by: str
    frames: int


def role_of_part(name: str) -> str | None:
    """``train``, ``val`` or ``test``: what a part is for, by its name; else None."""
    word = _word_of(name)
    if word is None:
        return None
    return "test" if word.lower().startswith("te") else _ROLES[word[0].lower()]


def _word_of(name: str) -> str | None:
    """The word for a part in a name: all of it, its beginning or its end."""
    ends = _SEPARATORS.split(name)
    words = (name, ends[0], ends[-1])
    return next((word for word in words if _SPLIT.fullmatch(word)), None)


def without_part(key: str, part: str | None) -> str:
    """The key of a frame without the folder that is called like its part.

    As it is, if the part has no name by which it is known again.
    """
    folders = key.split("/")
    if part not in folders[:-1] or not _SPLIT.fullmatch(part or ""):
        return key
    place = folders.index(part)
    return "/".join((*folders[:place], *folders[place + 1 :]))


def in_order_of_roles(names: Iterable[str]) -> list[str]:
    """Names of parts, each once: for training, validation, testing, then others."""
    roles = (*PARTS, None)
    return sorted(
        dict.fromkeys(names), key=lambda name: roles.index(role_of_part(name))
    )


def completed_parts(names: Iterable[str]) -> list[str]:
    """The parts of an export: for training, validation, testing, and others.

    Programs expect files of the first two, so they are there without frames, too.
    """
    there = list(names)
    roles = set(map(role_of_part, there))
    return in_order_of_roles([*there, *(n for n in PARTS[:2] if n not in roles)])


@lru_cache(4096)
def part_of_folder(folder: str) -> str | None:
    """The name of a part in the path of a folder.

    The first that is one as a whole, else the first that begins or ends like one.
    """
    names = [name for name in folder.split("/") if _word_of(name)]
    whole = (name for name in names if _SPLIT.fullmatch(name))
    return next(whole, names[0] if names else None)


def part_of_labels(file_name: str) -> str | None:
    """The part that the name of a COCO file says: ``instances_val2017.json``."""
    return _word_of(split_name(file_name)[0])


def folders_of_parts(names: Iterable[str]) -> frozenset[str]:
    """Of names of folders as `part_of_folder` gives them those that are parts.

    Names that only begin or end like one, such as ``test_drive``, are those of parts if
    no other name is one, and there are one for training and another one.
    """
    there = frozenset(names)
    whole = frozenset(name for name in there if _SPLIT.fullmatch(name))
    roles = set(map(role_of_part, there))
    return there if not whole and "train" in roles and len(roles) > 1 else whole


class RecordedSplits:
    """What a recording says about the parts of its frames.

    `counts` are those that were read last by part; ``None`` for those without one.
    """

    def __init__(self, root: Path, frames: FrameSet, told_by: SplitSource) -> None:
        self.counts: Counter[str | None] = Counter()
        self._root = root
        self._frames = frames
        self._told_by = told_by
        self._several: list[str] = []
        self._prefix = f"{str(root).rstrip(os.sep)}{os.sep}"

    def __iter__(self) -> Iterator[FrameSource]:
        """The frames with their parts."""
        self.counts.clear()
        self._several.clear()
        for frame in self._frames:
            yield self._with_part(frame)

    def notes(self) -> Iterator[str]:
        """How many frames each part has, if there are parts."""
        parts = in_order_of_roles(filter(None, self.counts))
        if parts:
            said = ", ".join(f"{name} {self.counts[name]:,}" for name in parts)
            others = self.counts[None]
            without = f"; {others:,} frames are in none" if others else ""
            yield f"parts as they came: {said}{without}"
        if self._several:
            yield (
                f"{len(self._several):,} frames are in the lists of several parts, and "
                f"taken to be in the first: {self._several[0]}"
            )

    def _with_part(self, frame: FrameSource) -> FrameSource:
        if frame.annotation is None:
            return frame
        own = frame.annotation.get("split")
        if self._told_by == "none":
            self.counts[None] += 1
            if own is None:
                return frame
            rest = {key: v for key, v in frame.annotation.items() if key != "split"}
            return replace(frame, annotation=rest)
        part = own if isinstance(own, str) else self._part(frame)
        self.counts[part] += 1
        if part is None or part == own:
            return frame
        return replace(frame, annotation={**frame.annotation, "split": part})

    def _part(self, frame: FrameSource) -> str | None:
        name = self._relative(frame.image) if frame.image else frame.label
        if name is None:
            name = frame.key
        if self._told_by in ("auto", "lists"):
            part = self._listed(frame, name)
            if part is not None:
                return part
        if self._told_by in ("auto", "folders"):
            part = part_of_folder(name.rpartition("/")[0])
            if part in self._folders:
                return part
        return None

    def _listed(self, frame: FrameSource, name: str) -> str | None:
        for folder, part in self._described:
            if f"{name.rpartition('/')[0]}/".startswith(folder):
                return part
        lists = self._lists
        parts = lists.parts_of(split_name(name)[0]) or lists.parts_of(frame.key)
        if len(parts) > 1:
            self._several.append(f"{frame.key} in {' and '.join(parts)}")
        return parts[0] if parts else None

    def _relative(self, path: Path) -> str:
        text = str(path)
        if text.startswith(self._prefix):
            text = text[len(self._prefix) :]
        return text.replace(os.sep, "/")

    @cached_property
    def _folders(self) -> frozenset[str]:
        """The names of folders that are parts."""
        names = set()
        for _, folders, _ in os.walk(self._root):
            names |= {name for name in folders if _word_of(name)}
        if self._frames.layout == "kitti":
            names -= _KITTI_FOLDERS
        return folders_of_parts(names)

    @cached_property
    def _described(self) -> list[tuple[str, str]]:
        """The folders of ``data.yaml`` with their parts, the longest first.

        A folder that is called like a part is that one. Another one that several parts
        name tells nothing.
        """
        parts: dict[str, set[str]] = {}
        for part, entry in self._of_yaml:
            folder = self._end_there(entry, Path.is_dir)
            if folder is not None and not entry.lower().endswith(".txt"):
                name = part_of_folder(folder)
                is_whole = name is not None and _SPLIT.fullmatch(name)
                names = parts.setdefault(f"{folder}/", set())
                names.add(name if is_whole and name else part)
        folders = [
            (folder, names.pop()) for folder, names in parts.items() if len(names) == 1
        ]
        return sorted(folders, key=lambda pair: -len(pair[0]))

    def _end_there(self, entry: str, is_there: Callable[[Path], bool]) -> str | None:
        """The longest end of a path that is in the recording.

        The path is perhaps one of another machine.
        """
        parts = _parts_of(entry)
        for start in range(len(parts)):
            end = "/".join(parts[start:])
            with suppress(OSError):  # a name that is too long for a file
                if is_there(self._root / end):
                    return end
        return None

    @cached_property
    def _lists(self) -> _Lists:
        lists = _Lists()
        for part, entry in self._of_yaml:
            name = self._end_there(entry, Path.is_file)
            if name is not None and entry.lower().endswith(".txt"):
                lists.add(part, self._root / name)
        for name in lists_below(self._root):
            word = _word_of(split_name(last_name(name))[0])
            if word is not None:
                lists.add(word, self._root / name)
        return lists

    @cached_property
    def _of_yaml(self) -> list[tuple[str, str]]:
        """The parts that ``data.yaml`` of YOLO names, each with a path."""
        if self._frames.layout != "yolo":
            return []
        path = next(
            filter(Path.is_file, (self._root / name for name in YAML_LISTS)), None
        )
        if path is None:
            return []
        try:
            document = parse_yaml(read_label_text(path, path.name))
        except (ConfigError, LayoutError):
            return []  # said by who reads the classes
        entries = document if isinstance(document, Mapping) else {}
        return [
            (part, entry)
            for part in _FROM_YAML
            for value in [entries.get(part)]
            for entry in (value if isinstance(value, list) else [value])
            if isinstance(entry, str)
        ]


def _parts_of(path: str) -> list[str]:
    names = path.replace("\\", "/").split("/")
    return [name for name in names if name not in ("", ".", "..")]


class _Lists:
    """Lists of frames' names by part."""

    def __init__(self) -> None:
        self._by_last: dict[str, list[tuple[list[str], str]]] = {}

    def add(self, part: str, path: Path) -> None:
        """The names of one list. One that cannot be read has none."""
        try:
            text = read_label_text(path, path.name)
        except LayoutError:
            return
        for line in text.splitlines():
            # The name in a line of a list, without the suffix of an image
            name = line.strip()
            stem, suffix = split_name(name)
            if suffix.lower() in IMAGE_SUFFIXES:
                line_name = stem
            else:
                first, _, rest = name.rpartition(" ")
                line_name = (
                    first.strip() if rest in ("-1", "0", "1") and first else name
                )
            if parts := _without_kinds(_parts_of(line_name)):
                self._by_last.setdefault(parts[-1], []).append((parts, part))

    def parts_of(self, name: str) -> list[str]:
        """The parts that list a frame: those whose paths end most like its name."""
        if not self._by_last:
            return []
        names = _without_kinds(_parts_of(name))
        lines = self._by_last.get(names[-1] if names else "", [])
        common = [common_end(line, names) for line, _ in lines]
        longest = max(common, default=0)
        parts = dict.fromkeys(
            part
            for (_, part), length in zip(lines, common, strict=True)
            if length == longest
        )
        unions = [part for part in parts if part.lower().startswith(_UNION)]
        return [part for part in parts if part not in unions] or unions


def _without_kinds(names: Sequence[str]) -> list[str]:
    """The names of a path without those of folders that say kinds of files."""
    folders = (name for name in names[:-1] if name.lower() not in FOLDER_WORDS)
    return [*folders, *names[-1:]]


def lists_below(root: Path) -> Iterator[str]:
    """Lists of the frames of a part: in ImageSets/, or train.txt in the top folder.

    Of the folders of ``ImageSets`` only one counts: ``Main``, which lists the frames of
    VOC's task of detection, else the first. Its lists for one class do not count.
    """
    if not root.is_dir():
        return
    sets: dict[Path, list[Path]] = {}
    for path in sorted((root / "ImageSets").rglob("*.txt")):
        if _SPLIT.fullmatch(path.stem):
            sets.setdefault(path.parent, []).append(path)
    chosen = min(
        sets, key=lambda folder: (folder.name != "Main", str(folder)), default=None
    )
    for path in sets.get(chosen, ()) if chosen else ():
        yield path.relative_to(root).as_posix()
    for path in sorted(root.glob("*.txt")):
        if any(map(_SPLIT.fullmatch, _SEPARATORS.split(path.stem))):
            yield path.name


def with_splits(frames: FrameSet, source: Path, told_by: SplitSource) -> FrameSet:
    """Frames with the parts of the recording as ``split`` of their annotations.

    What a frame says itself stays. `source` is the folder, or the file that was read.
    """
    root = source if source.is_dir() else source.parent
    splits = RecordedSplits(root, frames, told_by)
    notes = frames.notes
    return replace(
        frames, frames=lambda: iter(splits), notes=lambda: (*notes(), *splits.notes())
    )


def shares_of(asked: Sequence[float]) -> dict[str, float]:
    """The share of each part, 0..1: of one number the rest is that of ``val``.

    Empty if none is asked for.
    """
    if not asked:
        return {}
    shares = [*asked, 1 - asked[0]] if len(asked) == 1 else list(asked)
    return dict(zip(PARTS, shares, strict=False))


def next_part(shares: Mapping[str, float], counts: list[int]) -> str:
    """The part of the next of some frames, so that shares of their number are exact.

    Of n frames the first part has n times its share, rounded down, the second what it
    gets of the rest, and so on. `counts`, changed here, are the frames that the parts
    had to choose from so far.
    """
    left = 1.0
    *earlier, last = shares.items()
    for place, (part, share) in enumerate(earlier):
        own = min(1.0, share / left) if left > 0 else 0.0
        had = math.floor(counts[place] * own + _ROUNDING)
        counts[place] += 1
        if math.floor(counts[place] * own + _ROUNDING) > had:
            return part
        left -= share
    return last[0]


_ROUNDING: Final = 1e-9


def sequence_of(key: str, sequence: str | None = None) -> str | None:
    """The drive that a frame is of; None if nothing tells it.

    `sequence` is what its annotation says. Else it is the folder of the key, without
    those of cameras and parts, or what is before the last number of the key: ``run2``
    of ``run2/0007``, of ``train/run2/front/0007`` and of ``run2_0007``.
    """
    if sequence:
        return sequence
    *folders, _ = key.split("/")
    drives = [
        name for name in folders if not is_camera(name) and not _SPLIT.fullmatch(name)
    ]
    if drives:
        return "/".join(drives)
    name = _instant(key)
    number = _NUMBER.search(name)
    before = name[: number.start()].rstrip(" _.-") if number else ""
    return before or None


_COPY: Final = re.compile(r"\.rf\.[0-9a-zA-Z]+$")
"""How Roboflow ends the names of an image and its augmented copies."""


def _instant(key: str) -> str:
    """The name of a frame and of those of other cameras at the same instant."""
    return _COPY.sub("", last_name(key))


_NUMBER: Final = re.compile(r"(\d+)(?=\D*$)")
"""The last number of a name."""

_WHOLE: Final = 1 << 64

_GOLDEN: Final = 0x9E3779B97F4A7C15
"""2**64 divided by the golden ratio."""


def part_by_shares(
    key: str, map_name: str | None, sequence: str | None, shares: Mapping[str, float]
) -> str:
    """The part of a frame, from names alone, so that no other frame moves it.

    Parameters
    ----------
    sequence : str or None
        Of the annotation; see `sequence_of`. All frames of one sequence get one part.
        Where no sequence is known, each frame is one, with those of other cameras at
        the same instant.
    shares : mapping of str to float
        The share of each part, 0..1; their sum is 1.

    Notes
    -----
    A place from 0 to 1 is computed for each sequence, and the parts are intervals of
    these. Sequences whose names differ in the last number only, in one map, take
    places that are a golden ratio apart: of any that follow each other, each interval
    gets its share, but for one or two. Other names have the place of their hash: of n
    such sequences the share that comes out differs from the one asked for by about
    0.4 / sqrt(n), and with few of them a part may get none. In frames, shares differ
    more the less alike sequences are in length. To hold shares better, sequences would
    have to be known in advance, and later ones would move others.
    """
    name = sequence_of(key, sequence)
    if name is None:
        name = _instant(key)
    number = _NUMBER.search(name)
    words = f"{name[: number.start()]}\0{name[number.end() :]}" if number else name
    content = f"{map_name or ''}\0{words}".encode("utf-8", "surrogatepass")
    place = int.from_bytes(hashlib.sha256(content).digest()[:8], "big")
    if number:
        place = (place + int(number[0]) * _GOLDEN) % _WHOLE
    edge = 0.0
    for part, share in shares.items():
        edge += share
        if place < edge * _WHOLE:
            return part
    return max(shares, key=shares.__getitem__)  # the sum was less than 1 by rounding
