"""YOLO folders: images/ beside labels/, in any nesting, or both in one folder."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from filter_core.errors import FilterError
from filter_core.formats.class_lists import yolo_classes
from filter_core.formats.key_list import with_keys
from filter_core.formats.matching import IMAGE_SUFFIXES, FrameFiles, match, walk
from filter_core.formats.reading import (
    FrameSet,
    FrameSource,
    ReadOptions,
    read_label_text,
)
from filter_core.formats.yolo_text import read_label_lines

SEGMENTATION_FOLDERS: Final = ("seg", "segmentation", "segmentations", "semantic")

_BAND: Final = re.compile(r"label\d+", re.IGNORECASE)

_CLASS_LISTS: Final = frozenset({"classes.txt", "labels.txt"})

_TEXTS_AT_THE_TOP: Final = frozenset(
    {
        "labelmap.txt",
        "readme.txt",
        "requirements.txt",
        "train.txt",
        "val.txt",
        "test.txt",
    }
)
"""Lists of files and notes that lie beside a dataset; deeper down, such a name is a
frame's."""


@dataclass(frozen=True)
class LabelFolders:
    """Where a YOLO-like layout keeps its files, and what its numbers mean."""

    images: Path
    labels: Path
    segmentations: Path | None
    classes: tuple[str, ...]
    default_class: str = "unknown"


def read_yolo(root: Path, options: ReadOptions) -> FrameSet:
    """The frames of a YOLO folder; errors as `yolo_classes` and per frame."""
    classes = tuple(options.classes or yolo_classes(root))
    tags = options.segmentation or segmentation_folder(root)
    folders = LabelFolders(
        images=root,
        labels=options.labels or root,
        segmentations=tags,
        classes=classes,
        default_class=options.default_class,
    )
    skip = [*([tags] if tags else []), *band_folders(root)]
    labels = (name for name in walk(folders.labels, (".txt",), skip) if is_label(name))
    return frame_set("yolo", folders, labels)


def band_folders(root: Path) -> list[Path]:
    """Labels of distance bands beside ``labels``, which hold the same boxes again."""
    if not any((root / name).is_dir() for name in ("labels", "Annotations")):
        return []
    return [path for path in root.iterdir() if _BAND.fullmatch(path.name)]


def is_label(name: str) -> bool:
    """Whether a text file, relative to the dataset, holds boxes."""
    folder, _, base = name.lower().rpartition("/")
    if folder.split("/")[0] == "imagesets":
        return False
    return base not in _CLASS_LISTS and (folder or base) not in _TEXTS_AT_THE_TOP


def frame_set(layout: str, folders: LabelFolders, labels: Iterator[str]) -> FrameSet:
    """Frames of label files in YOLO's or carlasimu's form."""
    tags = folders.segmentations
    frames, unmatched = match(
        labels,
        walk(folders.images, IMAGE_SUFFIXES, [tags] if tags else []),
        walk(tags, IMAGE_SUFFIXES) if tags else (),
    )
    named = with_keys(folders.images, frames)
    return FrameSet(
        layout=layout,
        frames=lambda: _read_frames(folders, named),
        classes=folders.classes,
        count=len(frames),
        unmatched=unmatched,
    )


def segmentation_folder(root: Path) -> Path | None:
    """The folder of the segmentations, if it has one of the usual names."""
    candidates = (root / name for name in SEGMENTATION_FOLDERS)
    return next((path for path in candidates if path.is_dir()), None)


def _read_frames(
    folders: LabelFolders, frames: Sequence[FrameFiles]
) -> Iterator[FrameSource]:
    for files in frames:
        annotation: dict[str, object] | None = None
        problem: FilterError | None = None
        try:
            text = read_label_text(folders.labels / files.label, files.label)
            boxes = read_label_lines(
                text, files.label, folders.classes, folders.default_class
            )
            annotation = {"boxes": boxes}
        except FilterError as exc:
            problem = exc
        yield frame_of(
            files, folders.images, folders.segmentations, annotation, problem
        )


def frame_of(
    files: FrameFiles,
    images: Path,
    segmentations: Path | None,
    annotation: dict[str, object] | None,
    problem: FilterError | None,
) -> FrameSource:
    """A frame from the names of its files."""
    tags = None
    if segmentations is not None and files.segmentation is not None:
        tags = segmentations / files.segmentation
    if annotation is not None and files.map is not None:
        annotation = {"map": files.map, **annotation}
    return FrameSource(
        key=files.key,
        annotation=annotation,
        image=images / files.image if files.image else None,
        segmentation=tags,
        problem=problem,
    )
