"""Which layout a folder has, and the frames in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Final

from filter_core.errors import LayoutError
from filter_core.formats.carlasimu import camera_folder, read_carlasimu
from filter_core.formats.class_lists import find_class_list
from filter_core.formats.coco import coco_files, read_coco
from filter_core.formats.kitti import kitti_folder, read_kitti
from filter_core.formats.manifest import MANIFEST_NAME, read_manifest
from filter_core.formats.matching import walk
from filter_core.formats.reading import FrameSet, ReadOptions
from filter_core.formats.voc import read_voc_folder
from filter_core.formats.yolo import is_label, read_yolo
from filter_core.values import nearest

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
