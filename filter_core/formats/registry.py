"""The formats that go out: one table for service, client, command line and page."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal, Protocol

from filter_core.formats.coco_writer import CocoWriter
from filter_core.formats.cvat import CvatWriter
from filter_core.formats.decisions_writer import require_parquet, write_decisions
from filter_core.formats.export import ExportFrame, ExportHead, Sink
from filter_core.formats.export_options import ExportError, ExportOptions
from filter_core.formats.kitti_writer import KittiWriter
from filter_core.formats.label_studio import LabelStudioWriter
from filter_core.formats.manifest_writer import ManifestWriter
from filter_core.formats.tally import Counts
from filter_core.formats.voc_writer import VocWriter
from filter_core.formats.writing import NewWriter, write_labels
from filter_core.formats.yolo_writer import YoloWriter
from filter_core.values import nearest

FormatName = Literal[
    "yolo",
    "coco",
    "kitti",
    "voc",
    "cvat",
    "label-studio",
    "manifest",
    "decisions-jsonl",
    "decisions-csv",
    "decisions-parquet",
]

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


def write_export(
    name: str,
    frames: Iterable[ExportFrame],
    sink: Sink,
    head: ExportHead,
    options: ExportOptions,
) -> Counts:
    """Write frames in a format of `FORMATS`; returns the counts of ``manifest.json``.

    Errors as `format_of` and the format's writer.
    """
    return format_of(name, options).write(frames, sink, head, options)


def format_of(name: str, options: ExportOptions) -> Format:
    """The format of this name, if it can do what is asked.

    Raises
    ------
    ExportError
        There is no such format, or it has no such option.
    NotAvailable
        It needs a library that is not installed.
    """
    found = FORMATS.get(name)
    if found is None:
        raise ExportError(
            f"unknown format {name[:40]!r}; the nearest is {nearest(name, FORMATS)!r}",
            pointer="/format",
        )
    for option in sorted(options.changed() - found.options):
        heeded = ", ".join(sorted(found.options)) or "none"
        raise ExportError(
            f"format {name!r} has no option {option!r}; it has {heeded}",
            pointer=f"/options/{option}",
        )
    if name == "decisions-parquet":
        require_parquet()
    return found


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


def _decisions(form: str, title: str) -> Format:
    def write(
        frames: Iterable[ExportFrame],
        sink: Sink,
        head: ExportHead,
        options: ExportOptions,  # it heeds none
    ) -> Counts:
        return write_decisions(frames, sink, head, form)

    return Format(title, frozenset(), write)


FORMATS: Final[Mapping[str, Format]] = {
    "yolo": _labels("YOLO (Ultralytics)", YoloWriter, "bands"),
    "coco": _labels("COCO", CocoWriter, "bands", "rejected"),
    "kitti": _labels("KITTI", KittiWriter, "bands", "rejected"),
    "voc": _labels("Pascal VOC", VocWriter, "bands", "rejected"),
    "cvat": _labels("CVAT for images 1.1", CvatWriter, without={"split"}),
    "label-studio": _labels("Label Studio", LabelStudioWriter),
    "manifest": Format(
        "Unghost's own manifest",
        _CHOICE,
        partial(write_labels, new_writer=ManifestWriter),
    ),
    "decisions-jsonl": _decisions("jsonl", "Decisions, JSON lines"),
    "decisions-csv": _decisions("csv", "Decisions, CSV"),
    "decisions-parquet": _decisions("parquet", "Decisions, Parquet"),
}
"""By name, in the order in which they are offered; the names are `FormatName`'s."""
