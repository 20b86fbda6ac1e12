"""What a format says of itself: how it is recognised, read and written.

Each format's module declares one `Format`; `filter_core.formats.registry` lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Final, Literal, Protocol, TypeAlias, TypeVar

from filter_core.formats.export import (
    ExportFrame,
    ExportHead,
    ExportOptions,
    Sink,
)
from filter_core.formats.reading import FrameSet, ReadOptions, walk
from filter_core.formats.tally import Counts
from filter_core.formats.writing import NewWriter, write_labels

Likeness: TypeAlias = Literal["certain", "possible", "otherwise", "none"]
"""How sure a format is that a folder is its own.

``certain``: it is, and no format after this one is asked. ``possible``: it may be; if
several formats say so, a person has to choose. ``otherwise``: it may be if no format
says ``certain`` or ``possible``; of several, the first counts. ``none``: it is not.
"""

FRAME_OPTIONS: Final = frozenset({"include", "include_unmeasured", "images"})
"""The `ExportOptions` that say which boxes and images are written."""

LABEL_OPTIONS: Final = FRAME_OPTIONS | {"boxes", "split"}
"""Those that nearly every format of labels has."""

Need: TypeAlias = Literal["annotation", "image", "decisions", "decision_columns"]
"""What of a frame not every format writes.

``annotation``: the annotation as given, which is read when something of it is asked
for (`ExportFrame.given`); ``image``: the image, or its type; ``decisions``: an object
for each box, composed as for the API, which takes the most time; ``decision_columns``:
what tables have of it (`ExportFrame.columns`).
"""

LABEL_NEEDS: Final[frozenset[Need]] = frozenset({"annotation", "image"})
"""What formats of labels need."""

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


_Detector = TypeVar("_Detector", bound=Callable[[Source], Likeness])

_Reader = TypeVar("_Reader", bound=Callable[[Path, ReadOptions], FrameSet])

_Writer = TypeVar("_Writer", bound=Write)

_NewWriter = TypeVar("_NewWriter", bound=NewWriter)

_Requirement = TypeVar("_Requirement", bound=Callable[[], object])


@dataclass(kw_only=True, eq=False)
class Format:
    """A format of annotated frames, declared at the head of its module.

    What it can do follows in the module, each function under a decorator: `detector`,
    `reader`, `writer` (or `label_writer`) and `requirement`. What it cannot do stays
    None.

    Attributes
    ----------
    name : str
        As commands, URLs and stored exports have it.
    title : str
        As people call it.
    holds : str
        What its files hold, as the documentation says it, in Markdown.
    brief : str
        The same in a few words, for people who choose a format to write.
    recognised_by : str
        What `likeness` looks for, in words.
    options : frozenset of str
        The names of the `ExportOptions` that `write` uses; any other must keep its
        default.
    needs : frozenset of `Need`
        What of a frame `write` needs besides the columns of its boxes.
    likeness : callable or None
        Whether a source is in this format, told without reading its labels.
    read : callable or None
        Gives the frames of a folder or a file.
    write : callable or None
    require : callable or None
        Raises `NotAvailable` if a library that `write` needs is not installed.
    """

    name: str
    title: str
    holds: str
    brief: str = ""
    recognised_by: str = ""
    options: frozenset[str] = frozenset()
    needs: frozenset[Need] = frozenset()
    likeness: Callable[[Source], Likeness] | None = field(default=None, init=False)
    read: Callable[[Path, ReadOptions], FrameSet] | None = field(
        default=None, init=False
    )
    write: Write | None = field(default=None, init=False)
    require: Callable[[], object] | None = field(default=None, init=False)

    def detector(self, likeness: _Detector) -> _Detector:
        """Decorates the function that is `likeness`."""
        self.likeness = likeness
        return likeness

    def reader(self, read: _Reader) -> _Reader:
        """Decorates the function that is `read`."""
        self.read = read
        return read

    def writer(self, write: _Writer) -> _Writer:
        """Decorates the function that is `write`."""
        self.write = write
        return write

    def label_writer(self, new_writer: _NewWriter) -> _NewWriter:
        """Decorates the `LabelWriter` with which `write_labels` is `write`."""
        self.write = partial(write_labels, new_writer=new_writer)
        return new_writer

    def requirement(self, require: _Requirement) -> _Requirement:
        """Decorates the function that is `require`."""
        self.require = require
        return require
