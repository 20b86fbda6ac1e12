"""KITTI's object layout: folders label_2, image_2, calib and ImageSets.

A label file has a line of 15 columns for each object: its type, truncation, occlusion,
observation angle, rectangle in pixels and 3D box. The 3D box is given by its size, the
middle of its bottom face and its rotation about the vertical, in the axes of the camera
(x right, y down, z forward); `kitti_vertices` and `to_kitti_box` convert it to corners
as CARLA has them, and back.

References
----------
.. [1] Geiger, Lenz and Urtasun, KITTI object development kit, readme.txt,
   https://www.cvlibs.net/datasets/kitti/eval_object.php
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import BinaryIO, ClassVar, Final

import numpy as np

from filter_core.annotation.frame import FORMS_3D
from filter_core.arrays import FloatArray
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.export import ExportFrame
from filter_core.formats.files import number_text
from filter_core.formats.format import (
    LABEL_NEEDS,
    LABEL_OPTIONS,
    Format,
    Recognition,
    Source,
)
from filter_core.formats.matching import (
    FileIndex,
    FrameFileNames,
    frame_of,
    match,
    with_keys,
)
from filter_core.formats.reading import (
    BoxOrigin,
    FrameSet,
    FrameSource,
    annotated,
    open_regular,
    read_columns,
    read_label_text,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.same import (
    SOURCE_LABELS,
    BoxSpan,
    OwnLabels,
    OwnReading,
    Rectangles,
    spans_of_lines,
    stored_labels,
)
from filter_core.formats.splits import part_of_folder
from filter_core.formats.streams import Streams, auxiliary_folders
from filter_core.formats.writing import (
    RECTANGLE_KEYS,
    ExportContext,
    LabelBox,
    OutFrame,
    Traits,
    clipped,
)
from filter_core.geometry.box3d import in_carla_order
from filter_core.geometry.camera import CARLA_TO_IMAGE_AXES, Camera
from filter_core.images.header import read_image_size

KITTI: Final = Format(
    name="kitti",
    title="KITTI",
    docs_row=(
        "KITTI's 15 columns (a sixteenth, the score, is read, and written only with a "
        "line as it came): `training/label_2/`, `image_2/`, `calib/`, `ImageSets/`; "
        "frames have KITTI's number or a new one, and `frames.jsonl` says which is "
        "which"
    ),
    brief="label_2 with truncation and occlusion",
    recognised_by="KITTI's label_2/",
    needs=LABEL_NEEDS,
    options=LABEL_OPTIONS | {"bands", "rejected"},
)

_LABELS: Final = "label_2"

_IMAGES: Final = "image_2"

_CALIBRATIONS: Final = "calib"

_PLACES: Final = ("", "training")


@KITTI.recogniser
def _recognise(source: Source) -> Recognition:
    return "certain" if _kitti_folders(source.path) else "none"


def _kitti_folders(root: Path) -> list[Path]:
    """The folders that have ``label_2``.

    The one given, or ``training`` in it, or those of parts in it, as Datumaro has them.
    """
    for place in _PLACES:
        if (root / place / _LABELS).is_dir():
            return [root / place]
    below = sorted(root.iterdir()) if root.is_dir() else []
    return [
        path
        for path in below
        if part_of_folder(path.name) and (path / _LABELS).is_dir()
    ]


@KITTI.reader
def read_kitti(root: Path, options: RecordingDescription) -> FrameSet:
    """The frames of a KITTI folder; a bad file is its frame's problem.

    Raises `LayoutError`: there is no ``label_2``.
    """
    homes = _kitti_folders(root)
    if not homes and options.labels is None:
        raise LayoutError("expected label_2/ or training/label_2/, found neither")
    if len(homes) < 2:
        return _read_folder(root, [*homes, root][0], options)
    parts = {home.name: _read_folder(root, home, options) for home in homes}
    sets = parts.values()
    return FrameSet(
        layout="kitti",
        frames=lambda: (
            replace(frame, key=f"{name}/{frame.key}")
            for name, frames in parts.items()
            for frame in frames
        ),
        count=sum(frames.count or 0 for frames in sets),
        unmatched=tuple(chain.from_iterable(frames.unmatched for frames in sets)),
        notes=lambda: tuple(chain.from_iterable(frames.notes() for frames in sets)),
        streams=tuple(chain.from_iterable(frames.streams for frames in sets)),
        texts=lambda: chain.from_iterable(
            frames.texts() for frames in sets if frames.texts
        ),
    )


def _read_folder(root: Path, home: Path, options: RecordingDescription) -> FrameSet:
    images, labels = home / _IMAGES, options.labels or home / _LABELS
    beside = auxiliary_folders(home, root)
    streams = Streams(images, options, root=root, beside=beside)
    names = options.files.walk(root, labels, (".txt",))
    frames, unmatched = match(names, streams.images)
    frames, left_over = streams.complete(frames, "label file")
    folder = home / _CALIBRATIONS
    calibrations = FileIndex(options.files.walk(root, folder, (".txt",)))
    taken = {files.label: calibrations.take(files.key) for files in frames}
    named = with_keys(root, frames, f"{home.relative_to(root).as_posix()}/{_IMAGES}/")
    left = calibrations.left_over("no label file for this calibration")

    def read() -> Iterator[FrameSource]:
        for files in named:
            calibration = taken[files.label]
            origin = BoxOrigin(
                labels / files.label,
                calibration=folder / calibration if calibration else None,
            )
            frame = replace(frame_of(files, images), origin=origin)
            yield annotated(frame, partial(_annotation, frame, files, calibration))

    return FrameSet(
        layout="kitti",
        frames=read,
        count=len(frames),
        unmatched=(*unmatched, *left_over, *left),
        notes=partial(tuple, streams.notes),
        streams=streams.facts,
        texts=lambda: chain(
            (labels / files.label for files in named),
            (folder / name for name in taken.values() if name),
        ),
    )


def _annotation(
    frame: FrameSource, files: FrameFileNames, calibration: str | None
) -> dict[str, object]:
    origin = frame.origin
    assert origin is not None, "each frame has a label file"
    text = read_label_text(origin.file, files.label)
    lines = _read_kitti_lines(text, files.label)
    # The frame's camera, with the size of its images; None if either is missing
    path = frame.image or frame.segmentation or frame.others.get("instances")
    camera = None
    if origin.calibration and calibration and path:
        try:
            with open_regular(path) as image:
                wh = read_image_size(image.read())
        except OSError as exc:
            name = files.image or path.name
            raise LayoutError(f"{name}: cannot be read: {exc.strerror}") from exc
        text = read_label_text(origin.calibration, calibration)
        camera = _read_calibration(text, calibration, wh)
    boxes = [
        _box_of(kind, numbers, at, camera)
        for kind, numbers, at in lines
        if not _is_region(kind)
    ]
    annotation: dict[str, object] = {"boxes": boxes}
    regions = [numbers[3:7] for kind, numbers, _ in lines if _is_region(kind)]
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


@KITTI.spans
def _spans(file: BinaryIO) -> Iterator[BoxSpan]:
    """The lines of a label file that are no regions to ignore."""
    return spans_of_lines(
        file, lambda columns: bool(columns) and not _is_region(columns[0])
    )


def _read_kitti_lines(text: str, name: str) -> list[tuple[str, list[float], str]]:
    """The objects of one label file; `LayoutError` names file and line.

    Each with its type, its 14 numbers, or 15 with a score, and its place.
    """
    lines = []
    for number, line in enumerate(text.splitlines(), start=1):
        columns, at = line.split(), f"{name}, line {number}"
        if not columns:
            continue
        if len(columns) not in (15, 16):
            raise LayoutError(
                f"{at}: expected 15 columns (16 with a score), found {len(columns)}"
            )
        lines.append((columns[0], read_columns(columns[1:], at), at))
    return lines


_DONT_CARE: Final = "DontCare"
"""The type of a region that training and scoring ignore."""


def _is_region(name: str) -> bool:
    return name.lower() == _DONT_CARE.lower()


_UNKNOWN: Final = -999.0
"""Metres; KITTI gives -1000 for the location of a 3D box that is not known."""


_NO_RECTANGLE: Final = ([-1.0] * 4, [0.0] * 4)
"""Written in place of a rectangle that is not known: by KITTI, and by other tools."""


def kitti_vertices(
    dimensions: tuple[float, float, float],
    location: tuple[float, float, float],
    rotation_y: float,
) -> FloatArray:
    """(8, 3) float64, metres: corners in CARLA's order and axes of the camera.

    The axes are forward, right, up. `dimensions` are height, width and length in
    metres, `location` is the middle of the lower face in KITTI's camera (right, down,
    forward) in metres, and `rotation_y` radians.
    """
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


def _box_of(
    kind: str, numbers: list[float], at: str, camera: Camera | None
) -> dict[str, object]:
    """A line as a box of an annotation; the other columns are kept under ``kitti``.

    The rectangle counts where there is one, and is never replaced by another. A line
    that has only a 3D box, as some tools write, needs the camera.
    """
    truncated, occluded, alpha, *xyxy = numbers[:7]
    height, width, length, x, y, z, rotation = numbers[7:14]
    box: dict[str, object] = {"class": kind}
    vertices = None
    if min(height, width, length) > 0 and min(x, y, z) >= _UNKNOWN:
        vertices = kitti_vertices((height, width, length), (x, y, z), rotation)
    if xyxy in _NO_RECTANGLE:
        if vertices is None or camera is None:
            raise LayoutError(
                f"{at}: expected a rectangle, or a 3D box with the frame's image "
                f"and calibration, found the corners {tuple(xyxy)}"
            )
        return {**box, "vertices": vertices.tolist()}
    box["xyxy"] = xyxy
    kept: dict[str, object] = {
        "truncated": truncated,
        "occluded": int(occluded) if occluded.is_integer() else occluded,
        "alpha": alpha,
    }
    if vertices is not None:
        position = np.zeros(3) if camera is None else camera.position
        box["distance"] = round(
            float(np.linalg.norm(vertices.mean(axis=0) - position)), 4
        )
        kept["dimensions"] = [height, width, length]
        kept["location"] = [x, y, z]
        kept["rotation_y"] = rotation
    if len(numbers) > 14:
        kept["score"] = numbers[14]
    return {**box, "kitti": kept}


def _read_calibration(text: str, name: str, wh: tuple[int, int]) -> Camera:
    """The left colour camera (``P2``) of one calibration file.

    Its world is the coordinate system of the labels, in CARLA's axes.
    """
    rows = [line.partition(":") for line in text.splitlines()]
    values = [value for key, _, value in rows if key.strip() == "P2"]
    if not values:
        raise LayoutError(f"{name}: expected a line 'P2:', found none")
    numbers = read_columns(values[0].split(), f"{name}, P2")
    if len(numbers) != 12:
        raise LayoutError(f"{name}, P2: expected 12 numbers, found {len(numbers)}")
    projection = np.array(numbers).reshape(3, 4)
    try:
        right, down, forward = np.linalg.solve(projection[:, :3], projection[:, 3])
        motion = np.eye(4)
        motion[:3, 3] = forward, right, -down
        return Camera.from_matrices(*wh, projection[:, :3], motion)
    except (FilterError, np.linalg.LinAlgError) as exc:
        raise LayoutError(f"{name}, P2: not a valid camera: {exc}") from exc


def _rectangles(own: OwnLabels) -> list[Rectangles]:
    lines = _read_kitti_lines(own.text, own.file)
    return [
        {"xyxy": [numbers[3:7]]} for kind, numbers, _ in lines if not _is_region(kind)
    ]


@KITTI.label_writer
class KittiWriter:
    """Writes ``training/label_2/NNNNNN.txt`` and what belongs to it.

    Frames that came from a KITTI file keep its number, others are numbered in the order
    of the export; ``frames.jsonl`` gives their keys. Boxes to ignore are written as
    ``DontCare``.

    Truncation and occlusion are those of the KITTI file that a box came from. For any
    other box truncation is its share beyond the image, and occlusion is the level that
    was measured with depth, or 3 (unknown). The 3D columns follow from the 3D box and
    the camera; where either is missing they are those of the KITTI file, or KITTI's
    numbers for unknown.
    """

    traits: ClassVar[Traits] = Traits(
        image="training/image_2/{numbered}{suffix}",
        needs_key_list=True,
        own=OwnReading(_spans, _rectangles),
        box_keys=RECTANGLE_KEYS | {"kitti", "occluded", "distance", *FORMS_3D},
        frame_keys=frozenset(
            {"boxes", "map", "split", "camera", "dontcare", SOURCE_LABELS}
        ),
    )

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._types = kitti_types(context.head.classes)
        changed = {name: word for name, word in self._types.items() if name != word}
        if changed:
            context.facts["kitti_types"] = changed

    def labels(self, band: str, out: OutFrame) -> None:
        """One label file; that of all distances comes with calibration and split."""
        name = f"{out.numbered}.txt"
        labels = f"training/{band or 'label_2'}/{name}"
        text = self._composed(out) if out.own is None else self._own(out, band)
        self._context.sink(labels, [text.encode()])
        if band:
            return
        self._context.list_frame(out.part, out.numbered)
        camera = out.frame.given.camera
        if camera is not None:
            text = _own_calibration(out.frame, camera) or _calibration(camera)
            self._context.sink(f"training/calib/{name}", [text.encode()])

    def _own(self, out: OutFrame, band: str) -> str:
        """The frame's own label file without the boxes that are not written."""
        assert out.own is not None, "asked for without one"
        self._context.note_own(band)
        types = {
            box.row: self._types[out.frame.boxes.class_name(box.row)]
            for box in out.boxes
            if not box.ignored
        }
        ignored = [_ignored(box.xyxy) for box in out.boxes if box.ignored]
        text = out.own.with_words(types)
        end = "" if text.endswith("\n") or not text else "\n"
        return text + end * bool(ignored) + "".join(f"{line}\n" for line in ignored)

    def _composed(self, out: OutFrame) -> str:
        lines = [self._line(box, out.frame) for box in out.boxes]
        # Regions to ignore of the frame as given
        dontcare = out.frame.given.frame.get("dontcare")
        rows = dontcare if isinstance(dontcare, list) else []
        usable = [
            row
            for row in rows
            if isinstance(row, list)
            and len(row) == 4
            and all(isinstance(edge, (int, float)) for edge in row)
        ]
        if usable:
            regions = clipped(np.array(usable, np.float64), out.frame.wh)
            lines += [_ignored(xyxy) for xyxy in regions.tolist()]
        return "".join(f"{line}\n" for line in lines)

    def finish(self) -> None:
        """Which frames are for training."""
        self._context.write_lists("ImageSets")

    def _line(self, label_box: LabelBox, frame: ExportFrame) -> str:
        if label_box.ignored:
            return _ignored(label_box.xyxy)
        box = frame.given.boxes[label_box.row]
        original = box.get("kitti")
        original = original if isinstance(original, Mapping) else {}
        truncated = original.get("truncated")
        if not isinstance(truncated, (int, float)):
            truncated = label_box.cut
        measured = int(frame.boxes.occlusion[label_box.row])
        levels = (original.get("occluded"), box.get("occluded"), measured)
        valid_levels = (
            int(level)
            for level in levels
            if isinstance(level, int) and 0 <= level <= _UNKNOWN_OCCLUSION
        )
        occluded = next(valid_levels, _UNKNOWN_OCCLUSION)
        alpha, box3d = _columns_3d(label_box, frame, original)
        columns = (alpha, *label_box.xyxy, *box3d)
        first = (
            self._types[frame.boxes.class_name(label_box.row)],
            number_text(float(truncated)),
            str(occluded),
        )
        return " ".join([*first, *map(number_text, columns)])


def _own_calibration(frame: ExportFrame, camera: Camera) -> str | None:
    """The calibration that the frame's camera was read from, if it is still that."""
    text = stored_labels(frame.given, KITTI.name).get("calibration")
    if not isinstance(text, str):
        return None
    try:
        read = _read_calibration(text, "calibration", frame.wh)
    except LayoutError:
        return None
    same = np.array_equal(read.intrinsic, camera.intrinsic) and np.array_equal(
        read.world_to_camera, camera.world_to_camera
    )
    return text if same else None


def kitti_types(classes: Sequence[str]) -> dict[str, str]:
    """A word without a space for every class, different for each.

    KITTI's types differ in case, so `car` and `Car` are two; but nothing is called like
    the boxes to be ignored, in whatever case.
    """
    words: dict[str, str] = {}
    taken: set[str] = set()
    for name in classes:
        stem = "_".join(name.split()) or "_"
        word, number = stem, 2
        while word in taken or word.lower() == _DONT_CARE.lower():
            word, number = f"{stem}_{number}", number + 1
        taken.add(word)
        words[name] = word
    return words


_NO_BOX: Final = (-1.0, -1.0, -1.0, -1000.0, -1000.0, -1000.0, -10.0)
"""KITTI's own numbers for a 3D box that is not known."""

_NO_ALPHA: Final = -10.0


def _ignored(xyxy: Sequence[float]) -> str:
    columns = (*xyxy, *_NO_BOX)
    first = f"{_DONT_CARE} -1 -1 {number_text(_NO_ALPHA)}"
    return " ".join([first, *map(number_text, columns)])


_UNKNOWN_OCCLUSION: Final = 3
"""The largest of KITTI's levels."""


def _columns_3d(
    box: LabelBox, frame: ExportFrame, original: Mapping[str, object]
) -> tuple[float, Sequence[float]]:
    """Alpha and the seven 3D columns."""
    camera = frame.given.camera
    if camera is not None:
        vertices = frame.given.vertices[box.row]
        if not np.isnan(vertices[0, 0]):
            dimensions, location, rotation_y, alpha = to_kitti_box(vertices, camera)
            return alpha, (*dimensions, *location, rotation_y)
    numbers = [*_numbers(original, "dimensions"), *_numbers(original, "location")]
    rotation, heading = original.get("rotation_y"), original.get("alpha")
    alpha = float(heading) if isinstance(heading, (int, float)) else _NO_ALPHA
    if len(numbers) == 6 and isinstance(rotation, (int, float)):
        return alpha, (*numbers, float(rotation))
    return alpha, _NO_BOX


def _numbers(original: Mapping[str, object], key: str) -> list[float]:
    """The three numbers of a list; fewer if it has anything else."""
    value = original.get(key)
    if not isinstance(value, list) or len(value) != 3:
        return []
    return [float(number) for number in value if isinstance(number, (int, float))]


_BOTTOM: Final = [0, 2, 4, 6]
"""Corners at -z, in CARLA's order."""


def to_kitti_box(
    vertices: FloatArray, camera: Camera
) -> tuple[tuple[float, float, float], tuple[float, float, float], float, float]:
    """Dimensions, location, ``rotation_y`` and ``alpha`` of a box.

    Dimensions are height, width and length in metres; the location is that of the
    middle of the lower face, right, down and forward in metres; the rotation is about
    the axis that points down, and alpha is the rotation less the direction from the
    camera to the box, both in radians.

    The corners in the world, (8, 3) metres, may have any order: `in_carla_order`
    decides which axis is the length. KITTI turns boxes about one axis only. A camera
    that looks down or rolls sees boxes that are turned about the others as well; of
    those the heading is kept.
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
    # From -pi to pi
    alpha = math.remainder(rotation_y - math.atan2(x, z), 2 * math.pi)
    return (height, width, length), (x, y, z), rotation_y, alpha


_VELODYNE_AXES: Final = (0, -1, 0, 0, 0, 0, -1, 0, 1, 0, 0, 0)
"""From the LiDAR's axes (x forward, y left, z up) to the camera's; no shift."""

_IDENTITY: Final = (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)


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
