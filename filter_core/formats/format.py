"""`Format`: declares how a format is recognised, read and written.

Each format's module declares one `Format`; `filter_core.formats.registry` lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Final, Literal, Protocol, TypeAlias, TypeVar

from filter_core.formats.export import ExportFrame, ExportHead, ExportOptions, Sink
from filter_core.formats.reading import FrameSet
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.same import BoxSpans
from filter_core.formats.tables.patterns import FilePatterns
from filter_core.formats.tally import Counts
from filter_core.formats.writing import NewWriter, write_labels

Recognition: TypeAlias = Literal["certain", "possible", "fallback", "none"]
"""How certain it is that a source is in a format.

Formats are tried in a fixed order.

- ``certain``: it is in this format. No later format is tried.
- ``possible``: it may be. Later formats are tried, too; if one of them is ``possible``
  or ``certain`` as well, a person chooses.
- ``fallback``: it can be read in this format if no other is ``certain`` or
  ``possible``. The first such format is taken.
- ``none``: it is not in this format.
"""

FOLDER_OPTIONS: Final = frozenset({"segmentation", "labels", "files"})
"""The keys of a description that say where the files of a frame are."""

SELECTION_OPTIONS: Final = frozenset({"include", "include_unmeasured", "images"})
"""The `ExportOptions` that select what is written: which boxes, and images or none."""

LABEL_OPTIONS: Final = SELECTION_OPTIONS | {
    *("boxes", "allow_missing_images", "pictures"),
    *("split", "split_by", "val_maps"),
}
"""The `ExportOptions` of a format of labels; some have more, or not all of these."""

Need: TypeAlias = Literal[
    "annotation", "image", "files", "decisions", "decision_columns"
]
"""Data of a frame that only some formats need.

Every format gets the columns that labels are written from (`DecidedBoxes`).
``annotation``: the annotation as given, which is parsed on first use
(`ExportFrame.given`); ``image``: the image, and its type, which gives the suffix of
its path; ``files``: its other files; ``decisions``: a dictionary for each box, as in
the API, which takes the most time; ``decision_columns``: the columns of tables
(`ExportFrame.columns`).
"""

LABEL_NEEDS: Final[frozenset[Need]] = frozenset({"annotation", "image"})
"""The data that formats of labels need.

`write_labels` reads the annotation. It copies the image, or at least names its path,
which depends on its type.
"""

_FILES_LOOKED_AT: Final = 2000


@dataclass(frozen=True)
class Source:
    """A folder or a file whose format is to be recognised.

    Files that the description ignores (`files`) are not looked at.
    """

    path: Path
    files: FilePatterns = field(default_factory=FilePatterns)

    @cached_property
    def label_files(self) -> list[str]:
        """The first 2,000 ``.txt`` and ``.xml`` files of a folder, relative to it.

        Cached, because several formats need the list.
        """
        return list(islice(self.names((".txt", ".xml")), _FILES_LOOKED_AT))

    def names(self, suffixes: Collection[str] | None) -> Iterator[str]:
        """The files with one of the suffixes, or all, relative to the folder."""
        return self.files.walk(self.path, self.path, suffixes)


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


_Recogniser = TypeVar("_Recogniser", bound=Callable[[Source], Recognition])

_Reader = TypeVar("_Reader", bound=Callable[[Path, RecordingDescription], FrameSet])

_Writer = TypeVar("_Writer", bound=Write)

_NewWriter = TypeVar("_NewWriter", bound=NewWriter)

_BoxSpans = TypeVar("_BoxSpans", bound=BoxSpans)

_Requirement = TypeVar("_Requirement", bound=Callable[[], object])


@dataclass(kw_only=True, eq=False)
class Format:
    """A format of annotated frames, declared at the head of its module.

    The functions of the format follow in the module. Each has a decorator that stores
    it in an attribute: `recogniser` in `recognise`, `reader` in `read`, `writer` in
    `write`, `spans` in `box_spans`, `requirement` in `require`. If the format lacks
    one, the attribute stays None. So a `Format` is complete once its module has been
    imported.

    Attributes
    ----------
    name : str
        Its name in commands, URLs and stored exports.
    title : str
        Its name for people.
    docs_row : str
        Its files and what is in them, in Markdown, for the table in docs/formats.md.
    brief : str
        A few words below the title, where people choose the format of an export;
        empty if it cannot be written.
    recognised_by : str
        The files that `recognise` looks for, in words.
    read_options : frozenset of str
        Those of `READER_KEYS` that `read` uses; any other must keep its default.
    options : frozenset of str
        The names of the `ExportOptions` that `write` uses; any other must keep its
        default.
    needs : frozenset of `Need`
        The data of a frame that `write` needs besides the columns of its boxes.
    numbers_classes : bool
        Whether its labels name classes by their numbers, so that a list of classes must
        not change once labels are written.
    recognise : callable or None
        Returns whether a source is in this format, without reading its labels.
    read : callable or None
        Gives the frames of a folder or a file.
    write : callable or None
    box_spans : callable or None
        Gives the bytes of each box in a label file (`BoxSpans`), by which a recording
        can be written again without some boxes, and with nothing else changed.
    require : callable or None
        Raises `NotAvailable` if a library that `write` needs is not installed.
    """

    name: str
    title: str
    docs_row: str
    brief: str = ""
    recognised_by: str = ""
    read_options: frozenset[str] = FOLDER_OPTIONS
    options: frozenset[str] = frozenset()
    needs: frozenset[Need] = frozenset()
    numbers_classes: bool = False
    recognise: Callable[[Source], Recognition] | None = field(default=None, init=False)
    read: Callable[[Path, RecordingDescription], FrameSet] | None = field(
        default=None, init=False
    )
    write: Write | None = field(default=None, init=False)
    box_spans: BoxSpans | None = field(default=None, init=False)
    require: Callable[[], object] | None = field(default=None, init=False)

    def recogniser(self, recognise: _Recogniser) -> _Recogniser:
        """Decorates the function that is `recognise`."""
        self.recognise = recognise
        return recognise

    def reader(self, read: _Reader) -> _Reader:
        """Decorates the function that is `read`."""
        self.read = read
        return read

    def writer(self, write: _Writer) -> _Writer:
        """Takes the function that is `write`, also as a decorator."""
        self.write = write
        return write

    def label_writer(self, new_writer: _NewWriter) -> _NewWriter:
        """Decorates its `LabelWriter`: `write` then calls `write_labels` with it."""
        self.write = partial(write_labels, new_writer=new_writer)
        return new_writer

    def spans(self, box_spans: _BoxSpans) -> _BoxSpans:
        """Takes the function that is `box_spans`, also as a decorator."""
        self.box_spans = box_spans
        return box_spans

    def requirement(self, require: _Requirement) -> _Requirement:
        """Decorates the function that is `require`."""
        self.require = require
        return require
