"""Data sets in the tables of nuScenes: key frames of several cameras, and 3D boxes.

Boxes are in a world of their own, one for all cameras of a moment. Each frame has them
in the coordinates of its camera, from which they are projected like CARLA's.

References
----------
.. [1] The schema of the tables,
   https://github.com/nutonomy/nuscenes-devkit/blob/master/docs/schema_nuscenes.md
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from filter_core.arrays import FloatArray
from filter_core.errors import LayoutError
from filter_core.formats.format import Format, Recognition, Source
from filter_core.formats.matching import FileIndex, FrameFileNames, frame_of
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    FrameSet,
    FrameSource,
    Unmatched,
    annotated,
    frame_size,
    last_name,
    split_name,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.streams import Streams
from filter_core.formats.tables.rows import MAX_BYTES, read_document
from filter_core.geometry.camera import CARLA_TO_IMAGE_AXES
from filter_core.values import shown

NUSCENES: Final = Format(
    name="nuscenes",
    title="nuScenes",
    docs_row=(
        "the tables `sample_data.json`, `sample_annotation.json` and others in "
        "`v1.0-*/`, the images in `samples/`: key frames of every camera, with the 3D "
        "boxes of their moment"
    ),
    recognised_by="nuScenes' tables (v1.0-*/sample_annotation.json)",
    read_options=frozenset({"segmentation", "files"}),
)

_BOXES: Final = "sample_annotation"

_FILES: Final = "sample_data"

_TABLES: Final = (
    *(_FILES, _BOXES, "calibrated_sensor", "sensor", "ego_pose", "instance"),
    "category",
)

_NO_KEY_FRAMES: Final = ("sweeps", "maps")
"""Folders of images between key frames, and of maps."""

_SIGNS: Final = np.array([*itertools.product((-0.5, 0.5), repeat=3)])

_Row: TypeAlias = Mapping[str, object]

_Frame: TypeAlias = tuple[FrameFileNames, _Row]


@NUSCENES.recogniser
def _recognise(source: Source) -> Recognition:
    return "certain" if _folders_of_tables(source.path) else "none"


def _folders_of_tables(root: Path) -> list[Path]:
    """The folders of tables, such as ``v1.0-mini``."""
    return sorted(path.parent for path in root.glob(f"v1.0-*/{_BOXES}.json"))


@NUSCENES.reader
def read_nuscenes(root: Path, options: RecordingDescription) -> FrameSet:
    """A frame for each key frame of a camera, with the boxes of its moment.

    Raises `LayoutError`: there are no tables, or several versions of them; or one
    cannot be read.
    """
    folders = _folders_of_tables(root)
    if len(folders) != 1:
        names = " and ".join(path.name for path in folders) or "none"
        raise LayoutError(f"expected one folder of tables (v1.0-*), found {names}")
    (folder,) = folders
    tables = _Tables(folder)
    skip = [root / name for name in _NO_KEY_FRAMES]
    streams = Streams(root, options, skip=skip)
    images = FileIndex(streams.images)
    rows, repeated = tables.pictures()
    incomplete = [
        FrameFileNames(_key(row), "", images.take_named(_name(row))) for row in rows
    ]
    completed, left_over = streams.complete(incomplete, "key frame")
    pairs = zip(completed, rows, strict=True)
    frames: list[_Frame] = sorted(pairs, key=lambda pair: pair[0].key)

    def read() -> Iterator[FrameSource]:
        for files, row in frames:
            frame = replace(frame_of(files, root), label=None)
            yield annotated(frame, partial(tables.annotation, row, frame))

    return FrameSet(
        layout="nuscenes",
        frames=read,
        count=len(frames),
        unmatched=(
            *images.left_over("no key frame of sample_data.json names this image"),
            *left_over,
            *(
                Unmatched(_name(row), "named by sample_data.json, but not there")
                for files, row in frames
                if files.image is None
            ),
            *repeated,
        ),
        notes=partial(tuple, streams.notes),
        streams=streams.facts,
        texts=lambda: (folder / f"{name}.json" for name in _TABLES),
    )


def _name(row: _Row) -> str:
    return str(row.get("filename"))


def _key(row: _Row) -> str:
    """``CAM_FRONT/n015`` of ``samples/CAM_FRONT/n015.jpg``."""
    name = _name(row)
    folder = last_name(name.rpartition("/")[0])
    return f"{folder}/{split_name(last_name(name))[0]}"


class _Tables:
    """The tables of a folder, each by its tokens."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._tables = {name: self._read(name) for name in _TABLES}
        self._boxes: dict[str, list[_Row]] = defaultdict(list)
        for row in self._tables[_BOXES].values():
            self._boxes[_token(row, "sample_token")].append(row)

    def _read(self, name: str) -> dict[str, _Row]:
        at = f"{self._folder.name}/{name}.json"
        document = read_document(self._folder / f"{name}.json", at, MAX_BYTES)
        if not isinstance(document, list):
            raise LayoutError(f"{at}: expected a list of rows, found {shown(document)}")
        rows = (row for row in document if isinstance(row, Mapping))
        return {_token(row, "token"): row for row in rows}

    def pictures(self) -> tuple[list[_Row], list[Unmatched]]:
        """The rows of images of key frames; those that repeat a key are listed."""
        by_key: dict[str, _Row] = {}
        repeated = []
        for row in self._tables[_FILES].values():
            is_picture = _name(row).lower().endswith(IMAGE_SUFFIXES)
            if not row.get("is_key_frame") or not is_picture:
                continue
            if by_key.setdefault(_key(row), row) is not row:
                why = f"another key frame is called {_key(row)}, too"
                repeated.append(Unmatched(_name(row), why))
        return [*by_key.values()], repeated

    def annotation(self, row: _Row, frame: FrameSource) -> dict[str, object]:
        """The camera of an image, and the boxes of its moment in its coordinates."""
        sensor = self._row("calibrated_sensor", row, "calibrated_sensor_token")
        vehicle = self._row("ego_pose", row, "ego_pose_token")
        rows = self._boxes.get(_token(row, "sample_token"), [])
        with np.errstate(over="ignore", invalid="ignore"):  # refused by its numbers
            boxes = [self._box(box, vehicle, sensor) for box in rows]
        width, height = frame_size(frame) or (row.get("width"), row.get("height"))
        camera = {
            "width": width,
            "height": height,
            "intrinsic": sensor.get("camera_intrinsic"),
            "world_to_camera": np.eye(4).tolist(),
        }
        return {"boxes": boxes, "camera": camera}

    def _row(self, table: str, row: _Row, key: str) -> _Row:
        other = self._tables[table].get(_token(row, key))
        if other is None:
            raise LayoutError(
                f"{table}.json: expected a row with the token {shown(row.get(key))}, "
                "found none"
            )
        return other

    def _box(self, row: _Row, vehicle: _Row, sensor: _Row) -> dict[str, object]:
        width, length, height = _numbers(row, "size", 3)
        points = _SIGNS * (length, width, height)
        points = points @ _rotation(row).T + _numbers(row, "translation", 3)
        for frame in (vehicle, sensor):
            points = (points - _numbers(frame, "translation", 3)) @ _rotation(frame)
        instance = self._row("instance", row, "instance_token")
        return {
            "id": row.get("instance_token"),
            "class": self._row("category", instance, "category_token").get("name"),
            "vertices": (points @ CARLA_TO_IMAGE_AXES).tolist(),
            "distance": float(np.linalg.norm(points.mean(axis=0))),
        }


def _token(row: _Row, key: str) -> str:
    token = row.get(key)
    return token if isinstance(token, str) else ""


def _numbers(row: _Row, key: str, count: int) -> FloatArray:
    value = row.get(key)
    try:
        numbers = np.array(value, np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise LayoutError(
            f"token {row.get('token')}, {key}: expected {count} numbers, found "
            f"{shown(value)}"
        )
    return numbers


def _rotation(row: _Row) -> FloatArray:
    """The matrix of a quaternion w, x, y, z."""
    quaternion = _numbers(row, "rotation", 4)
    length = np.linalg.norm(quaternion)
    if not length:
        raise LayoutError(
            f"token {row.get('token')}, rotation: expected a quaternion, found zeros"
        )
    w, x, y, z = quaternion / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
