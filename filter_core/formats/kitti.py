"""KITTI's object layout: label_2 and its 15 columns, image_2, calib and ImageSets.

A label is one line: type, truncation, occlusion, alpha, rectangle, and a 3D box as its
bottom centre, sizes and heading in the axes of the camera (x right, y down, z forward),
which `kitti_vertices` and `to_kitti_box` turn into CARLA's and back.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from filter_core.errors import FilterError, LayoutError
from filter_core.formats.files import number_text
from filter_core.formats.format import LABEL_OPTIONS, Format, Likeness, Source
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    FileIndex,
    FrameFiles,
    FrameSet,
    FrameSource,
    ReadOptions,
    frame_of,
    match,
    read_columns,
    read_label_text,
    segmentation_folder,
    walk,
    with_keys,
)
from filter_core.formats.writing import (
    PARTS,
    ExportContext,
    OutBox,
    OutFrame,
    Traits,
    clipped,
    write_labels,
)
from filter_core.geometry.box3d import in_carla_order
from filter_core.geometry.camera import CARLA_TO_IMAGE_AXES, Camera
from filter_core.images.header import read_image_header
from filter_core.types import FloatArray

_BOTTOM: Final = [0, 2, 4, 6]
"""Corners at -z, in CARLA's order."""


@dataclass(frozen=True)
class KittiBox:
    """A 3D box as KITTI gives it: x right, y down, z forward.

    Attributes
    ----------
    dimensions : height, width and length, metres
    location : of the middle of the bottom face, metres
    rotation_y : radians, about the axis that points down
    alpha : radians
        The heading as the camera sees it: without the direction to the box.
    """

    dimensions: tuple[float, float, float]
    location: tuple[float, float, float]
    rotation_y: float
    alpha: float


def to_kitti_box(vertices: FloatArray, camera: Camera) -> KittiBox:
    """A box from its world corners.

    Parameters
    ----------
    vertices : (8, 3), metres
        In any order; `in_carla_order` has the last word on which axis is the length.
    camera : Camera

    Notes
    -----
    KITTI turns boxes about one axis only. A camera that looks down or rolls sees boxes
    that are turned about the others as well; of those the heading is kept.
    """
    corners = in_carla_order(vertices)[0]
    motion = camera.world_to_camera
    moved = corners @ motion[:3, :3].T + motion[:3, 3]
    seen = moved @ CARLA_TO_IMAGE_AXES.T
    length, width, height = (
        float(np.linalg.norm(seen[bit] - seen[0])) for bit in (4, 2, 1)
    )
    x, y, z = (float(v) for v in seen[_BOTTOM].mean(axis=0))
    forward = seen[4] - seen[0]
    rotation_y = math.atan2(-float(forward[2]), float(forward[0]))
    return KittiBox(
        dimensions=(height, width, length),
        location=(x, y, z),
        rotation_y=rotation_y,
        alpha=_half_turn(rotation_y - math.atan2(x, z)),
    )


def kitti_vertices(
    dimensions: tuple[float, float, float],
    location: tuple[float, float, float],
    rotation_y: float,
) -> FloatArray:
    """(8, 3) corners in CARLA's axes of the camera (forward, right, up) and order."""
    height, width, length = dimensions
    cos, sin = math.cos(rotation_y), math.sin(rotation_y)
    forward = np.array([cos, 0.0, -sin]) * length
    right = np.array([-sin, 0.0, -cos]) * width
    up = np.array([0.0, -height, 0.0])
    corners = [
        np.array(location) + (x - 0.5) * forward + (y - 0.5) * right + z * up
        for x in (0, 1)
        for y in (0, 1)
        for z in (0, 1)
    ]
    vertices: FloatArray = np.array(corners) @ CARLA_TO_IMAGE_AXES
    return vertices


def _half_turn(angle: float) -> float:
    """The same angle from -pi to pi."""
    return math.remainder(angle, 2 * math.pi)


_COLUMNS: Final = (15, 16)

_DONT_CARE: Final = "dontcare"

_UNKNOWN: Final = -999.0
"""Locations below are KITTI's way to say that there is none."""


@dataclass(frozen=True)
class KittiLine:
    """One object: its type and its 14 numbers, or 15 with a score."""

    type: str
    numbers: tuple[float, ...]

    @property
    def xyxy(self) -> list[float]:
        """Left, top, right, bottom."""
        return list(self.numbers[3:7])

    @property
    def is_region(self) -> bool:
        """Whether it only says where not to look."""
        return self.type.lower() == _DONT_CARE

    @property
    def has_rectangle(self) -> bool:
        """Whether its rectangle has an extent."""
        x_min, y_min, x_max, y_max = self.xyxy
        return x_max > x_min and y_max > y_min

    @property
    def vertices(self) -> FloatArray | None:
        """(8, 3) metres in CARLA's axes of the labels' camera; None if not known."""
        height, width, length, x, y, z, rotation = self.numbers[7:14]
        if min(height, width, length) <= 0 or min(x, y, z) < _UNKNOWN:
            return None
        return kitti_vertices((height, width, length), (x, y, z), rotation)


def read_kitti_lines(text: str, name: str) -> list[KittiLine]:
    """The lines of one label file; `LayoutError` names file and line."""
    lines = []
    for number, line in enumerate(text.splitlines(), start=1):
        columns = line.split()
        if columns:
            lines.append(_line(columns, f"{name}, line {number}"))
    return lines


def read_calibration(text: str, name: str, wh: tuple[int, int]) -> Camera:
    """The left colour camera (``P2``) of one calibration file.

    The world is the labels' own frame, in CARLA's axes.

    Raises
    ------
    LayoutError
        No ``P2``, or it is no camera.
    """
    rows = [line.partition(":") for line in text.splitlines()]
    found = [value for key, _, value in rows if key.strip() == "P2"]
    if not found:
        raise LayoutError(f"{name}: expected a line 'P2:', found none")
    numbers = read_columns(found[0].split(), f"{name}, P2")
    if len(numbers) != 12:
        raise LayoutError(f"{name}, P2: expected 12 numbers, found {len(numbers)}")
    projection = np.array(numbers).reshape(3, 4)
    try:
        right, down, forward = np.linalg.solve(projection[:, :3], projection[:, 3])
        motion = np.eye(4)
        motion[:3, 3] = forward, right, -down
        return Camera.from_matrices(*wh, projection[:, :3], motion)
    except (FilterError, np.linalg.LinAlgError) as exc:
        raise LayoutError(f"{name}, P2: not a camera: {exc}") from exc


def box_of(line: KittiLine, camera: Camera | None) -> dict[str, Any]:
    """A line as a box of an annotation; the other columns are kept under ``kitti``.

    The rectangle counts where there is one. A line that has only a 3D box, as some
    tools write, needs the camera.
    """
    truncated, occluded, alpha = line.numbers[:3]
    box: dict[str, Any] = {"class": line.type}
    vertices = line.vertices
    if not line.has_rectangle and vertices is not None and camera is not None:
        return {**box, "vertices": vertices.tolist()}
    box["xyxy"] = line.xyxy
    kept: dict[str, Any] = {
        "truncated": truncated,
        "occluded": int(occluded) if occluded.is_integer() else occluded,
        "alpha": alpha,
    }
    if vertices is not None:
        box["distance"] = _distance(vertices, camera)
        kept["dimensions"] = list(line.numbers[7:10])
        kept["location"] = list(line.numbers[10:13])
        kept["rotation_y"] = line.numbers[13]
    if len(line.numbers) > 14:
        kept["score"] = line.numbers[14]
    return {**box, "kitti": kept}


def _distance(vertices: FloatArray, camera: Camera | None) -> float:
    position = np.zeros(3) if camera is None else camera.position
    return round(float(np.linalg.norm(vertices.mean(axis=0) - position)), 4)


def _line(columns: Sequence[str], at: str) -> KittiLine:
    if len(columns) not in _COLUMNS:
        raise LayoutError(
            f"{at}: expected 15 columns (16 with a score), found {len(columns)}"
        )
    return KittiLine(columns[0], tuple(read_columns(columns[1:], at)))


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


DONT_CARE: Final = "DontCare"

_NO_BOX: Final = (-1.0, -1.0, -1.0, -1000.0, -1000.0, -1000.0, -10.0)
"""KITTI's own numbers for a 3D box that is not known."""

_NO_ALPHA: Final = -10.0

_UNKNOWN_OCCLUSION: Final = 3

_VELODYNE_AXES: Final = (0, -1, 0, 0, 0, 0, -1, 0, 1, 0, 0, 0)

_IDENTITY: Final = (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)


class KittiWriter:
    """Writes ``training/label_2/NNNNNN.txt`` and what belongs to it.

    Frames are numbered in the order of the export, ``frames.jsonl`` says which is
    which. Boxes to ignore are ``DontCare``. What a KITTI file said of truncation,
    occlusion, alpha and the 3D box is given back; else truncation is the share beyond
    the image, occlusion is what depth says of it, 3 (unknown) without, and the 3D
    columns come from the 3D box and the camera, or are KITTI's numbers for unknown.

    References
    ----------
    .. [1] Geiger, Lenz and Urtasun, KITTI object development kit, readme.txt,
       https://www.cvlibs.net/datasets/kitti/eval_object.php
    """

    traits: ClassVar[Traits] = Traits("kitti", keys=True)

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._types = kitti_types(context.head.classes)
        self._parts = {part: context.spool() for part in PARTS}
        changed = {name: word for name, word in self._types.items() if name != word}
        if changed:
            context.facts["kitti_types"] = changed

    def image(self, out: OutFrame) -> str:
        """The name of a frame's image in the export."""
        return f"training/image_2/{out.number:06}{out.suffix}"

    def labels(self, band: str, out: OutFrame) -> None:
        """One label file; with the first, calibration and part too."""
        name = f"{out.number:06}.txt"
        lines = [self._line(one, out.frame.camera) for one in out.boxes]
        lines += [_ignored(xyxy) for xyxy in _regions(out)]
        text = "".join(f"{line}\n" for line in lines)
        self._context.sink(f"training/{band or 'label_2'}/{name}", [text.encode()])
        if band:
            return
        self._parts[out.part].write(f"{out.number:06}\n".encode())
        if out.frame.camera is not None:
            calibration = _calibration(out.frame.camera)
            self._context.sink(f"training/calib/{name}", [calibration.encode()])

    def finish(self) -> None:
        """Which frames are for training."""
        for part, spool in self._parts.items():
            self._context.sink(f"ImageSets/{part}.txt", spool.pieces())

    def _line(self, out: OutBox, camera: Camera | None) -> str:
        if out.ignored:
            return _ignored(out.xyxy)
        given = out.box.given.get("kitti")
        given = given if isinstance(given, Mapping) else {}
        alpha, solid = _solid(out, camera, given)
        columns = (alpha, *out.xyxy, *solid)
        first = (
            self._types[out.box.class_name],
            number_text(_truncated(out, given)),
            str(_occluded(out, given)),
        )
        return " ".join([*first, *map(number_text, columns)])


def kitti_types(classes: Sequence[str]) -> dict[str, str]:
    """A word without a space for every class, different for each."""
    words: dict[str, str] = {}
    taken = {DONT_CARE.lower()}
    for name in classes:
        stem = "_".join(name.split()) or "_"
        word, number = stem, 2
        while word.lower() in taken:
            word, number = f"{stem}_{number}", number + 1
        taken.add(word.lower())
        words[name] = word
    return words


def _solid(
    out: OutBox, camera: Camera | None, given: Mapping[str, Any]
) -> tuple[float, Sequence[float]]:
    """Alpha and the seven 3D columns."""
    if out.box.vertices is not None and camera is not None:
        box = to_kitti_box(out.box.vertices, camera)
        return box.alpha, (*box.dimensions, *box.location, box.rotation_y)
    numbers = [*_list(given, "dimensions", 3), *_list(given, "location", 3)]
    rotation = given.get("rotation_y")
    alpha = float(given.get("alpha", _NO_ALPHA))
    if len(numbers) == 6 and isinstance(rotation, (int, float)):
        return alpha, (*numbers, float(rotation))
    return alpha, _NO_BOX


def _list(given: Mapping[str, Any], key: str, length: int) -> list[float]:
    value = given.get(key)
    if not isinstance(value, list) or len(value) != length:
        return []
    return [float(one) for one in value if isinstance(one, (int, float))]


def _truncated(out: OutBox, given: Mapping[str, Any]) -> float:
    value = given.get("truncated")
    return float(value) if isinstance(value, (int, float)) else out.cut


def _occluded(out: OutBox, given: Mapping[str, Any]) -> int:
    said = (given.get("occluded"), out.box.given.get("occluded"))
    for value in (*said, out.box.decision.get("occluded")):
        if isinstance(value, int) and 0 <= value <= _UNKNOWN_OCCLUSION:
            return int(value)
    return _UNKNOWN_OCCLUSION


def _ignored(xyxy: Sequence[float]) -> str:
    columns = (*xyxy, *_NO_BOX)
    first = f"{DONT_CARE} -1 -1 {number_text(_NO_ALPHA)}"
    return " ".join([first, *map(number_text, columns)])


def _regions(out: OutFrame) -> list[Sequence[float]]:
    """Regions to ignore that came with the frame."""
    given = out.frame.annotation.get("dontcare")
    rows = given if isinstance(given, list) else []
    usable = [row for row in rows if isinstance(row, list) and len(row) == 4]
    return [clipped(row, out.frame.wh) for row in usable]


def _calibration(camera: Camera) -> str:
    projection = np.hstack([camera.intrinsic, np.zeros((3, 1))]).ravel().tolist()
    rows = {
        **{f"P{number}": projection for number in range(4)},
        "R0_rect": np.eye(3).ravel().tolist(),
        "Tr_velo_to_cam": _VELODYNE_AXES,
        "Tr_imu_to_velo": _IDENTITY,
    }
    return "".join(
        f"{name}: {' '.join(f'{float(v):.12e}' for v in row)}\n"
        for name, row in rows.items()
    )


def _likeness(source: Source) -> Likeness:
    return "none" if kitti_folder(source.path) is None else "certain"


KITTI: Final = Format(
    name="kitti",
    title="KITTI",
    likeness=_likeness,
    read=read_kitti,
    write=partial(write_labels, new_writer=KittiWriter),
    options=LABEL_OPTIONS | {"bands", "rejected"},
)
