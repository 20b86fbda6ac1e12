"""What is told of streams: how many images they have, and which pattern names them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from filter_core.formats.reading import StreamFacts, last_name, split_name
from filter_core.formats.streams.images import Image
from filter_core.formats.tables.patterns import CAMERA, FRAME, FilePattern
from filter_core.formats.words import VIEW_WORD, Role, part_of


class StreamPart(NamedTuple):
    """Images of a stream that have one role, or none; see `StreamFacts`.

    `ending` is that of the stream, as `Endings.of` says it.
    """

    role: Role | None
    images: Sequence[Image]
    told_by: tuple[str, ...]
    ending: str = ""

    @property
    def around(self) -> tuple[str, str]:
        """What the name of each has before and behind the frame's part."""
        first = self.images[0]
        stem, suffix = split_name(last_name(first.name))
        before, behind = "", ""
        if self.ending:
            is_before = self.ending.endswith("_")
            constant = self.ending.strip("_")
            before, behind = stem[: len(constant) + 1], stem[-len(constant) - 1 :]
            before, behind = (before, "") if is_before else ("", behind)
        elif first.in_words and (frame := last_name(first.frame)):
            before, _, behind = stem.partition(frame)
        return before, f"{behind}{suffix}"


def streams_of(images: Iterable[Image]) -> Iterator[list[Image]]:
    """The images of each stream."""
    by_stream: dict[tuple[str, ...], list[Image]] = {}
    for image in images:
        by_stream.setdefault(image.stream, []).append(image)
    yield from by_stream.values()


class _PatternFinder:
    """Finds patterns that match the images of some parts of streams, and no others.

    Of others it may match those whose own patterns are more specific. `parts` are all
    images of a folder. What the name of a folder has besides words that say what files
    are is in braces where folders differ.
    """

    def __init__(self, parts: Sequence[StreamPart]) -> None:
        self.around = [part.around for part in parts]
        self._by_folder: dict[str, dict[int, list[str]]] = {}
        for number, part in enumerate(parts):
            for image in part.images:
                folder = image.name.rpartition("/")[0]
                parts_there = self._by_folder.setdefault(folder, {})
                parts_there.setdefault(number, []).append(image.name)

    def pattern_of(self, numbers: Collection[int]) -> FilePattern | None:
        """The pattern of the images of these parts; None if there is none."""
        before, behind = self.around[min(numbers)]
        name = f"{before}{{{FRAME}}}{behind}"
        folders = [
            folder
            for folder, parts in self._by_folder.items()
            if not parts.keys().isdisjoint(numbers)
        ]
        for place in _folder_patterns(folders):
            try:
                pattern = FilePattern(f"{place}{name}")
            except ValueError:  # names with braces or colons
                continue
            if self._fits(pattern, place, numbers):
                return pattern
        return None

    def _fits(self, pattern: FilePattern, place: str, numbers: Collection[int]) -> bool:
        """Whether a pattern is that of just the images of these parts."""
        folder_fits = FilePattern(f"{place}{{{FRAME}}}").match
        for folder, parts in self._by_folder.items():
            if folder_fits(f"{folder}/0".removeprefix("/")) is None:
                if not parts.keys().isdisjoint(numbers):
                    return False
                continue
            for number, paths in parts.items():
                is_ours = number in numbers
                if not is_ours and self._fixed(number) > self._fixed(min(numbers)):
                    continue
                if any((pattern.match(path) is None) is is_ours for path in paths):
                    return False
        return True

    def _fixed(self, number: int) -> int:
        """How many characters of the names of a part are always the same."""
        return sum(map(len, self.around[number]))


def _folder_patterns(folders: Sequence[str]) -> Iterator[str]:
    """Beginnings of patterns for folders at one depth, each with a slash at its end."""
    levels = [folder.split("/") for folder in folders]
    if len({len(parts) for parts in levels}) != 1:
        return
    names = [list(dict.fromkeys(each)) for each in zip(*levels, strict=True)]
    if names == [[""]]:
        yield ""
        return
    yield "".join(_level_patterns(names, lambda name: part_of(name).frame))
    if any(len(each) > 1 for each in names):
        yield "".join(_level_patterns(names, lambda name: name))


def _level_patterns(
    names: Sequence[Sequence[str]], frame_part: Callable[[str], str]
) -> Iterator[str]:
    """The pattern of each level of folders, of which these are the names."""
    words: Counter[str] = Counter()
    for of_level in names:
        if len(of_level) == 1:
            yield f"{of_level[0]}/"
            continue
        rests = [frame_part(name) for name in of_level]
        around = {
            name.partition(rest)[::2] if rest else ("", "")
            for name, rest in zip(of_level, rests, strict=True)
        }
        before, behind = around.pop()
        if around or "" in rests:
            rests, before, behind = [*of_level], "", ""
        word = CAMERA if all(map(VIEW_WORD.search, rests)) else "part"
        words[word] += 1
        number = words[word] if words[word] > 1 else ""
        yield f"{before}{{{word}{number}}}{behind}/"


_MOST_ALONE: Final = 64
"""Streams that are listed one by one if no pattern names all of them."""


def facts_of(
    parts: Sequence[StreamPart], folder: Path, root: Path
) -> Iterator[StreamFacts]:
    """What is known of streams in a folder; those that one pattern names are one."""
    finder = _PatternFinder(parts)
    alike: dict[tuple[object, ...], list[int]] = {}
    for number, part in enumerate(parts):
        depth = part.images[0].name.count("/")
        kind = part.role, depth, *finder.around[number]
        alike.setdefault(kind, []).append(number)
    path = os.path.relpath(folder, root).replace(os.sep, "/")
    is_inside = path.split("/")[0] != ".."
    prefix = f"{path if is_inside else folder.name}/" if path != "." else ""
    is_inside &= not {*"{}*:"} & {*prefix}
    for numbers in alike.values():
        pattern = finder.pattern_of(numbers)
        groups = [[number] for number in numbers]
        if pattern or len(numbers) > _MOST_ALONE:
            groups = [numbers]
        for group in groups:
            own = pattern
            if len(group) == 1:
                own = pattern or finder.pattern_of(group)
            told = [word for number in group for word in parts[number].told_by]
            yield StreamFacts(
                parts[group[0]].role or "unclear",
                sum(len(parts[number].images) for number in group),
                f"{prefix}{parts[group[0]].images[0].name}",
                tuple(dict.fromkeys(told)),
                f"{prefix}{own.text}" if own and is_inside else None,
            )
