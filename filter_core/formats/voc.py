"""Pascal VOC folders: one XML per image, beside it or in a parallel folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from filter_core.errors import FilterError
from filter_core.formats.key_list import with_keys
from filter_core.formats.matching import IMAGE_SUFFIXES, FrameFiles, match, walk
from filter_core.formats.reading import (
    FrameSet,
    FrameSource,
    ReadOptions,
    read_label_bytes,
)
from filter_core.formats.voc_xml import read_voc
from filter_core.formats.yolo import band_folders, frame_of, segmentation_folder


@dataclass(frozen=True)
class _VocFolders:
    images: Path
    labels: Path
    segmentations: Path | None


def read_voc_folder(root: Path, options: ReadOptions) -> FrameSet:
    """The frames of a VOC folder; a file that is not VOC is that frame's problem."""
    tags = options.segmentation or segmentation_folder(root)
    folders = _VocFolders(root, options.labels or root, tags)
    skip = [*([tags] if tags else []), *band_folders(root)]
    frames, unmatched = match(
        walk(folders.labels, (".xml",), skip),
        walk(root, IMAGE_SUFFIXES, skip),
        walk(tags, IMAGE_SUFFIXES) if tags else (),
    )
    named = with_keys(root, frames)
    return FrameSet(
        layout="voc",
        frames=lambda: _read_frames(folders, named),
        count=len(frames),
        unmatched=unmatched,
    )


def _read_frames(
    folders: _VocFolders, frames: Sequence[FrameFiles]
) -> Iterator[FrameSource]:
    for files in frames:
        annotation: dict[str, object] | None = None
        problem: FilterError | None = None
        try:
            content = read_label_bytes(folders.labels / files.label, files.label)
            annotation = read_voc(content, files.label)
        except FilterError as exc:
            problem = exc
        yield frame_of(
            files, folders.images, folders.segmentations, annotation, problem
        )
