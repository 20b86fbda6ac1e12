"""What a format says of itself: how it is recognised, read and written.

Each format's module declares one `Format`; `filter_core.formats.registry` lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Final, Literal, Protocol, TypeAlias

from filter_core.formats.export import (
    ExportFrame,
    ExportHead,
    ExportOptions,
    Sink,
)
from filter_core.formats.reading import FrameSet, ReadOptions, walk
from filter_core.formats.tally import Counts

Likeness: TypeAlias = Literal["certain", "possible", "none"]
"""``certain`` settles the format of a folder; ``possible`` only if no other is."""

FRAME_OPTIONS: Final = frozenset({"include", "include_unmeasured", "images"})
"""The `ExportOptions` that say which boxes and images are written."""

LABEL_OPTIONS: Final = FRAME_OPTIONS | {"boxes", "split"}
"""Those that nearly every format of labels has."""

_FILES_LOOKED_AT: Final = 2000


@dataclass(frozen=True)
class Source:
    """A folder or a file whose format is to be recognised.

    Attributes
    ----------
    path : Path
    """

    path: Path

    @cached_property
    def label_files(self) -> list[str]:
        """The first 2,000 ``.txt`` and ``.xml`` files of a folder, relative to it.

        Listed once, however many formats ask.
        """
        return list(islice(walk(self.path, (".txt", ".xml")), _FILES_LOOKED_AT))


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


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of annotated frames; what it cannot do is None.

    Attributes
    ----------
    name : str
        As commands, URLs and stored exports have it.
    title : str
        As people call it.
    likeness : callable or None
        Whether a source is in this format, told without reading its labels.
    read : callable or None
        Gives the frames of a folder or a file.
    write : callable or None
    options : frozenset of str
        The names of the `ExportOptions` that `write` heeds; any other must stay as it
        is.
    whole_decisions : bool
        Whether `write` needs all that is known of a decision. A format of labels needs
        what `filter_core.decisions.record.label_dicts` gives.
    require : callable or None
        Raises `NotAvailable` if a library that `write` needs is not installed.
    """

    name: str
    title: str
    likeness: Callable[[Source], Likeness] | None = None
    read: Callable[[Path, ReadOptions], FrameSet] | None = None
    write: Write | None = None
    options: frozenset[str] = frozenset()
    whole_decisions: bool = False
    require: Callable[[], object] | None = None
