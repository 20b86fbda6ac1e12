"""The one door: formats in order, read_source, detect_layout, write_export.

The formats that go out: one table for service, client, command line and page.

Which layout a folder has, and the frames in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final, Literal

from filter_core.errors import LayoutError
from filter_core.formats.carlasimu import camera_folder, read_carlasimu
from filter_core.formats.coco import CocoWriter, coco_files, read_coco
from filter_core.formats.cvat import CvatWriter
from filter_core.formats.decisions import require_parquet, write_decisions
from filter_core.formats.export import (
    ExportError,
    ExportFrame,
    ExportHead,
    ExportOptions,
    Sink,
)
from filter_core.formats.format import _CHOICE, Format, _labels
from filter_core.formats.kitti import KittiWriter, kitti_folder, read_kitti
from filter_core.formats.label_studio import LabelStudioWriter
from filter_core.formats.manifest import MANIFEST_NAME, ManifestWriter, read_manifest
from filter_core.formats.reading import FrameSet, ReadOptions, walk
from filter_core.formats.tally import Counts
from filter_core.formats.voc import VocWriter, read_voc_folder
from filter_core.formats.writing import write_labels
from filter_core.formats.yolo import YoloWriter, find_class_list, is_label, read_yolo
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

_READERS: Final[dict[str, Callable[[Path, ReadOptions], FrameSet]]] = {
    "manifest": read_manifest,
    "carlasimu": read_carlasimu,
    "yolo": read_yolo,
    "kitti": read_kitti,
    "voc": read_voc_folder,
    "coco": read_coco,
}

LAYOUTS: Final = ("auto", *_READERS)
"""What `read_source` takes."""

_FILES_LOOKED_AT: Final = 2000


def read_source(
    source: Path, layout: str = "auto", options: ReadOptions | None = None
) -> FrameSet:
    """The frames of a folder or a manifest, in the order of their keys or lines.

    Parameters
    ----------
    source : Path
        A folder in a recognised layout, a ``.jsonl`` file, or COCO's ``.json`` file.
    layout : {"auto", "manifest", "carlasimu", "yolo", "kitti", "voc", "coco"}
    options : ReadOptions, optional

    Raises
    ------
    LayoutError
        Nothing there, no layout or several recognised, or no list of classes.
    """
    if not source.exists():
        raise LayoutError(f"{source.name}: expected a folder or a manifest, found none")
    name = detect_layout(source) if layout == "auto" else layout
    if name not in _READERS:
        raise LayoutError(
            f"unknown layout {name[:40]!r}; the nearest is {nearest(name, LAYOUTS)!r}"
        )
    return _READERS[name](source, options or ReadOptions())


def detect_layout(source: Path) -> str:
    """The one layout that the files of a folder speak for.

    Raises
    ------
    LayoutError
        None or several; names what was looked for or found.
    """
    found = list(_layouts_of(source))
    if len(found) == 1:
        return found[0]
    if found:
        raise LayoutError(
            f"{source.name}: could be {' or '.join(found)}; name the layout"
        )
    raise LayoutError(
        f"{source.name}: no layout recognised; expected {MANIFEST_NAME}, carlasimu's "
        "labels/labelNN/ or label/, YOLO's labels with data.yaml or classes.txt, "
        "KITTI's label_2/, Pascal VOC's .xml files, or a COCO .json file"
    )


def _layouts_of(source: Path) -> Iterator[str]:
    if source.is_file():
        yield "coco" if source.suffix.lower() == ".json" else "manifest"
        return
    if (source / MANIFEST_NAME).is_file():
        yield "manifest"
        return
    if kitti_folder(source) is not None:
        yield "kitti"
        return
    if camera_folder(source) is not None:
        yield "carlasimu"
        return
    names = list(islice(walk(source, (".txt", ".xml")), _FILES_LOOKED_AT))
    if any(name.lower().endswith(".xml") for name in names):
        yield "voc"
    labelled = any(n.lower().endswith(".txt") and is_label(n) for n in names)
    if labelled and find_class_list(source):
        yield "yolo"
    if coco_files(source):
        yield "coco"
