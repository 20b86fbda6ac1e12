"""What is told of streams: how many images they have, and which pattern names them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from filter_core.formats.reading import StreamFacts, last_name, split_name
from filter_core.formats.streams.images import Image
from filter_core.formats.tables.patterns import NamedFiles, PatternFinder
from filter_core.formats.words import Role, part_of


class StreamPart(NamedTuple):
    """Images of a stream that have one role, or none; see `StreamFacts`.

    `ending` is that of the stream, as `Endings.of` says it.
    """

    role: Role | None
    images: Sequence[Image]
    told_by: tuple[str, ...]
    ending: str = ""

    @property
    def named(self) -> NamedFiles:
        """Their names."""
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
        paths = [image.name for image in self.images]
        return NamedFiles(paths, before, f"{behind}{suffix}")


def streams_of(images: Iterable[Image]) -> Iterator[list[Image]]:
    """The images of each stream."""
    by_stream: dict[tuple[str, ...], list[Image]] = {}
    for image in images:
        by_stream.setdefault(image.stream, []).append(image)
    yield from by_stream.values()


_MOST_ALONE: Final = 64
"""Streams that are listed one by one if no pattern names all of them."""


def facts_of(
    parts: Sequence[StreamPart], folder: Path, root: Path
) -> Iterator[StreamFacts]:
    """What is known of streams in a folder; those that one pattern names are one."""
    named = [part.named for part in parts]
    finder = PatternFinder(named, lambda name: part_of(name).frame)
    alike: dict[tuple[object, ...], list[int]] = {}
    for number, (part, files) in enumerate(zip(parts, named, strict=True)):
        depth = part.images[0].name.count("/")
        kind = part.role, depth, files.before, files.behind
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
