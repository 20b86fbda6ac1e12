"""KITTI's object layout: label_2 beside image_2 and calib."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from filter_core.errors import FilterError, LayoutError
from filter_core.formats.key_list import with_keys
from filter_core.formats.kitti_text import box_of, read_calibration, read_kitti_lines
from filter_core.formats.matching import (
    IMAGE_SUFFIXES,
    FileIndex,
    FrameFiles,
    match,
    walk,
)
from filter_core.formats.reading import (
    FrameSet,
    FrameSource,
    ReadOptions,
    read_label_text,
)
from filter_core.formats.yolo import frame_of, segmentation_folder
from filter_core.geometry.camera import Camera
from filter_core.images.header import read_image_header

_LABELS: Final = "label_2"

_IMAGES: Final = "image_2"

_CALIBRATIONS: Final = "calib"

_PLACES: Final = ("", "training")


@dataclass(frozen=True)
class _KittiFolders:
    images: Path
    labels: Path
    calibrations: Path
    segmentations: Path | None


def kitti_folder(root: Path) -> Path | None:
    """The folder that has ``label_2``: the one given, or ``training`` in it."""
    places = (root / place for place in _PLACES)
    return next((place for place in places if (place / _LABELS).is_dir()), None)


def read_kitti(root: Path, options: ReadOptions) -> FrameSet:
    """The frames of a KITTI folder; a bad file is its frame's problem.

    Raises
    ------
    LayoutError
        There is no ``label_2``.
    """
    home = kitti_folder(root)
    if home is None and options.labels is None:
        raise LayoutError("expected label_2/ or training/label_2/, found neither")
    home = home or root
    folders = _KittiFolders(
        images=home / _IMAGES,
        labels=options.labels or home / _LABELS,
        calibrations=home / _CALIBRATIONS,
        segmentations=options.segmentation
        or segmentation_folder(home)
        or segmentation_folder(root),
    )
    tags = folders.segmentations
    frames, unmatched = match(
        walk(folders.labels, (".txt",)),
        walk(folders.images, IMAGE_SUFFIXES),
        walk(tags, IMAGE_SUFFIXES) if tags else (),
    )
    calibrations = FileIndex(walk(folders.calibrations, (".txt",)))
    taken = {files.label: calibrations.take(files.key) for files in frames}
    named = with_keys(root, frames, f"{home.relative_to(root).as_posix()}/{_IMAGES}/")
    left = calibrations.left_over("no label file for this calibration")
    return FrameSet(
        layout="kitti",
        frames=lambda: _read_frames(folders, named, taken),
        count=len(frames),
        unmatched=(*unmatched, *left),
    )


def _read_frames(
    folders: _KittiFolders,
    frames: Sequence[FrameFiles],
    calibrations: dict[str, str | None],
) -> Iterator[FrameSource]:
    for files in frames:
        annotation: dict[str, Any] | None = None
        problem: FilterError | None = None
        try:
            annotation = _annotation(folders, files, calibrations[files.label])
        except FilterError as exc:
            problem = exc
        yield frame_of(
            files, folders.images, folders.segmentations, annotation, problem
        )


def _annotation(
    folders: _KittiFolders, files: FrameFiles, calibration: str | None
) -> dict[str, Any]:
    text = read_label_text(folders.labels / files.label, files.label)
    lines = read_kitti_lines(text, files.label)
    camera = _camera(folders, files, calibration)
    boxes = [box_of(line, camera) for line in lines if not line.is_region]
    annotation: dict[str, Any] = {"boxes": boxes}
    regions = [line.xyxy for line in lines if line.is_region]
    if regions:
        annotation["dontcare"] = regions
    if camera is not None:
        annotation["camera"] = {
            "width": camera.width,
            "height": camera.height,
            "intrinsic": camera.intrinsic.tolist(),
            "world_to_camera": camera.world_to_camera.tolist(),
        }
    return annotation


def _camera(
    folders: _KittiFolders, files: FrameFiles, calibration: str | None
) -> Camera | None:
    """The frame's camera; its image says how large it is."""
    if calibration is None or files.image is None:
        return None
    try:
        header = read_image_header((folders.images / files.image).read_bytes())
    except OSError as exc:
        raise LayoutError(f"{files.image}: cannot be read: {exc.strerror}") from exc
    text = read_label_text(folders.calibrations / calibration, calibration)
    return read_calibration(text, calibration, header.wh)
