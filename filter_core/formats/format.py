"""What a format says of itself: its title, its options, and how it is written."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from filter_core.formats.export import (
    ExportFrame,
    ExportHead,
    ExportOptions,
    Sink,
)
from filter_core.formats.tally import Counts
from filter_core.formats.writing import NewWriter, write_labels

_CHOICE: Final = frozenset({"include", "include_unmeasured", "images"})

_LABELS: Final = _CHOICE | {"boxes", "split"}


class Write(Protocol):
    """Writes frames into a sink."""

    def __call__(
        self,
        frames: Iterable[ExportFrame],
        sink: Sink,
        head: ExportHead,
        options: ExportOptions,
    ) -> Counts:
        """Read frames once, one at a time; returns the counts."""


@dataclass(frozen=True)
class Format:
    """A format that labels can be written in.

    Attributes
    ----------
    title : str
        As people call it.
    options : frozenset of str
        The names of the `ExportOptions` that it heeds; any other must stay as it is.
    write : callable
    """

    title: str
    options: frozenset[str]
    write: Write


def _labels(
    title: str,
    writer: NewWriter,
    *more: str,
    without: Collection[str] = (),
) -> Format:
    def write(
        frames: Iterable[ExportFrame],
        sink: Sink,
        head: ExportHead,
        options: ExportOptions,
    ) -> Counts:
        return write_labels(frames, sink, head, options, writer)

    return Format(title, _LABELS.union(more).difference(without), write)
