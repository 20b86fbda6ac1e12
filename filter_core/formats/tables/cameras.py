"""``cameras`` of a description: where cameras stand, and how they see.

A camera's pose in the world is ``pose``, or that of a vehicle, ``pose``, times where
the camera is mounted on it, ``mount``. Each is said in the description, or is a path in
the labels, or in a file of its own.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path as FilePath
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from filter_core.arrays import FloatArray
from filter_core.config.declaration import refuse_unknown_keys, wrong_value
from filter_core.errors import LayoutError
from filter_core.formats.tables.box_rows import BoxReader
from filter_core.formats.tables.fields import (
    BoxFields,
    Path,
    as_number,
    checked_path,
    transform_of,
)
from filter_core.formats.tables.patterns import (
    CAMERA,
    FRAME,
    FilePattern,
    Values,
    plain,
)
from filter_core.formats.tables.rows import (
    MAX_BYTES,
    Lines,
    read_document,
    table_suffix,
)
from filter_core.geometry.pose import Transform
from filter_core.values import shown

WORLD_TO_CAMERA: Final = "world_to_camera"

KEYS: Final = (
    *("width", "height", "fov", "intrinsic", "pose", "mount", WORLD_TO_CAMERA),
)

_FILE_KEYS: Final = ("file", "path", "negated")

_NUMBERS: Final = ("x", "y", "z", "pitch", "yaw", "roll")

_TRANSFORM_KEYS: Final = frozenset(
    {"x", "y", "z", "location", "translation", "position", "rotation", "yaw"}
)

_NAME: Final = re.compile(r"\{([A-Za-z_]\w*)\}")


class InFile(NamedTuple):
    """A value in a file beside the labels.

    Attributes
    ----------
    file : FilePattern
        Its path below the folder, perhaps with names of the patterns in braces.
    path : str or None
        A JMESPath, in which such names are replaced, too. None: what the file has
        under the frame's or the camera's name.
    negated : tuple of str
        Numbers of a pose that have the opposite sign of CARLA's.
    """

    file: FilePattern
    path: str | None = None
    negated: tuple[str, ...] = ()


Where: TypeAlias = "InFile | Path | Mapping[str, object] | float"
"""Where a value is: in a file, in the labels; or the value."""


@dataclass(frozen=True)
class CameraPlaces:
    """``cameras`` of a description: the place of each of `KEYS`."""

    places: Mapping[str, Where] = field(default_factory=dict)

    @property
    def document(self) -> dict[str, object]:
        """What a description says."""
        document: dict[str, object] = {}
        for key, place in self.places.items():
            if isinstance(place, InFile):
                said = {
                    "file": place.file.text,
                    "path": place.path,
                    "negated": list(place.negated),
                }
                document[key] = {name: value for name, value in said.items() if value}
            else:
                document[key] = place.text if isinstance(place, Path) else place
        return document

    @property
    def files(self) -> tuple[FilePattern, ...]:
        """The files that it names."""
        files = (
            place.file for place in self.places.values() if isinstance(place, InFile)
        )
        return tuple(dict.fromkeys(files))

    def below(self, folder: str) -> CameraPlaces:
        """The same in a folder, which may be a name in braces itself."""
        places = {
            key: place._replace(file=place.file.below(folder))
            if isinstance(place, InFile)
            else place
            for key, place in self.places.items()
        }
        return CameraPlaces(places)


class AllowedCameras:
    """Where the numbers of cameras are."""

    def __str__(self) -> str:
        return f"an object with {', '.join(KEYS)}"

    def checked(self, name: str, value: object, at: str = "") -> CameraPlaces:
        if isinstance(value, CameraPlaces):
            return value
        if not isinstance(value, Mapping):
            raise wrong_value(name, value, str(self), at)
        place = f"{at}/{name}"
        refuse_unknown_keys(value, KEYS, at=place)
        return CameraPlaces(
            {
                key: _where(key, raw, place)
                for key, raw in value.items()
                if raw is not None
            }
        )

    def schema(self) -> dict[str, object]:
        return {
            "type": "object",
            "properties": {key: {} for key in KEYS},
            "additionalProperties": False,
        }


def _where(key: str, value: object, at: str) -> Where:
    if isinstance(value, Mapping):
        if "file" not in value:
            return dict(value)
        place = f"{at}/{key}"
        refuse_unknown_keys(value, _FILE_KEYS, at=place)
        path = None if value.get("path") is None else str(value["path"])
        if path is not None:
            checked_path("path", _NAME.sub("0", path), place)
        negated = value.get("negated") or []
        if not isinstance(negated, list) or not {*map(str, negated)} <= {*_NUMBERS}:
            expected = f"a list of {', '.join(_NUMBERS)}"
            raise wrong_value("negated", negated, expected, place)
        file = _file(key, str(value["file"]), at)
        return InFile(file, path, tuple(map(str, negated)))
    if isinstance(value, str):
        if table_suffix(value):
            return InFile(_file(key, value, at))
        checked_path(key, _NAME.sub("x", value), at)
        return Path(value)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    expected = "a value, a path in the labels, or {file, path}"
    raise wrong_value(key, value, expected, at)


def _file(key: str, file: str, at: str) -> FilePattern:
    try:
        pattern = FilePattern(file)
    except ValueError as exc:
        raise wrong_value(key, file, str(exc), at) from exc
    if "*" in file or not table_suffix(file):
        raise wrong_value(key, file, "a .json, .jsonl, .csv, .tsv or .npz file", at)
    return pattern


class Cameras:
    """The cameras of the frames of a recording, whose folder is `root`."""

    def __init__(self, root: FilePath, places: CameraPlaces) -> None:
        self._root, self._places = root, places.places
        self._files: dict[str, _File] = {}

    def of(
        self, values: Values, labels: object, wh: tuple[int, int] | None
    ) -> dict[str, object]:
        """The camera of a frame, as an annotation has it; empty if none is described.

        Parameters
        ----------
        values : mapping of str to str
            What the names in the patterns stand for.
        labels : object
            What the label file has of the frame.
        wh : (width, height), px, or None
            The size of the image, if the description does not say it.

        Raises
        ------
        LayoutError
            A value is not where the description says; names file and key.
        """
        if not self._places:
            return {}
        camera: dict[str, object] = {}
        for key, side in zip(("width", "height"), wh or (None, None), strict=True):
            number = self._value(key, values, labels)
            if (size := side if number is None else number) is not None:
                camera[key] = size
        for key in ("fov", "intrinsic"):
            if (value := self._value(key, values, labels)) is not None:
                camera[key] = as_number(value) if isinstance(value, str) else value
        matrix = self._world_to_camera(values, labels)
        return (
            camera if matrix is None else {**camera, WORLD_TO_CAMERA: matrix.tolist()}
        )

    def _world_to_camera(self, values: Values, labels: object) -> FloatArray | None:
        matrix = self._pose(WORLD_TO_CAMERA, values, labels)
        poses = (self._pose(key, values, labels) for key in ("pose", "mount"))
        both = [pose for pose in poses if pose is not None]
        if matrix is not None or not both:
            return matrix
        pose = np.linalg.multi_dot(both) if len(both) > 1 else both[0]
        try:
            return np.linalg.inv(pose)
        except np.linalg.LinAlgError as exc:
            raise _error("pose", pose.tolist(), "a rigid motion") from exc

    def _pose(self, key: str, values: Values, labels: object) -> FloatArray | None:
        value = self._value(key, values, labels)
        if value is None:
            return None
        if isinstance(value, list):
            matrix = np.array(value, np.float64) if len(value) == 4 else np.empty(0)
            if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
                raise _error(key, value, "a matrix of 4 rows of 4 numbers")
            return matrix
        try:
            numbers = transform_of(value)
        except ValueError as exc:
            raise _error(key, value, str(exc)) from exc
        where = self._places[key]
        for name in where.negated if isinstance(where, InFile) else ():
            numbers[name] *= -1
        x, y, z, pitch, yaw, roll = (numbers[name] for name in _NUMBERS)
        return Transform((x, y, z), (pitch, yaw, roll)).matrix

    def _value(self, key: str, values: Values, labels: object) -> object:
        where = self._places.get(key)
        if where is None:
            return None
        if isinstance(where, InFile):
            return self._in_file(key, where, values)
        if isinstance(where, Path):
            where = Path(_NAME.sub(lambda match: _quoted(match, values), where.text))
            if (value := where.of(labels)) is None:
                raise _error(key, None, f"a value in the labels, at {where.text}")
            return value
        if isinstance(where, Mapping) and not where.keys() & _TRANSFORM_KEYS:
            if (value := where.get(values.get(CAMERA, ""))) is None:
                expected = f"a value of camera {values.get(CAMERA)!r}"
                raise _error(key, dict(where), expected)
            return value
        return where

    def _in_file(self, key: str, where: InFile, values: Values) -> object:
        lacking = [name for name in where.file.names if name not in values]
        if lacking:
            raise _error(
                key, where.file.text, f"only names of frames, not {lacking[0]}"
            )
        name = where.file.filled(values)
        file = self._files.get(name)
        if file is None:
            file = self._files[name] = _File(self._root / name, name)
            if len(self._files) > _MOST_FILES:
                self._files.pop(next(iter(self._files)))
        if where.path is None:
            value = file.of(values)
        else:
            path = _NAME.sub(lambda match: _quoted(match, values), where.path)
            value = checked_path(key, path, "/cameras").of(file.document)
        if value is None:
            about = where.path or f"frame {values.get(FRAME)}"
            raise LayoutError(f"cameras.{key}: {name} has nothing at {about}")
        return value


_MOST_FILES: Final = 16
"""That are kept in memory."""


def _quoted(name: re.Match[str], values: Values) -> str:
    """The value of a name in a path, if it cannot be taken for a part of the path.

    That of a name in capitals is in capitals, too.
    """
    value = values.get(name[1])
    if value is None:
        value = values.get(name[1].lower(), name[0])
        value = value.upper() if name[1].isupper() else value
    if not {*"'\"`\\"}.isdisjoint(value):
        raise LayoutError(f"cameras: expected no quotes in {name[1]}, found {value!r}")
    return value


def _error(key: str, value: object, expected: str) -> LayoutError:
    return LayoutError(f"cameras.{key}: expected {expected}, found {shown(value)}")


class _File:
    """A file with values of frames, of cameras, or of both."""

    def __init__(self, path: FilePath, name: str) -> None:
        document = read_document(path, name, MAX_BYTES)
        if isinstance(document, Lines):
            document = [row.value for _, row in document]
        self.document = document
        self._name = name

    def of(self, values: Values) -> object:
        """What it has of a frame and a camera; None if nothing."""
        if isinstance(self.document, list):
            keys = [(plain(values.get(FRAME, "")), values.get(CAMERA, ""))]
            keys += [(keys[0][0], ""), ("", keys[0][1])]
            return next((self._rows[key] for key in keys if key in self._rows), None)
        part: object = self.document
        for name in (FRAME, CAMERA, FRAME):
            if isinstance(part, Mapping):
                key = _key_in(part, values.get(name, ""))
                part = part if key is None else part[key]
        if part is self.document and isinstance(part, Mapping):
            keys_in_file = {str(key).lower() for key in part}
            return part if keys_in_file & _TRANSFORM_KEYS else None
        return part

    @cached_property
    def _rows(self) -> dict[tuple[str, str], object]:
        fields = BoxReader(BoxFields())
        rows: dict[tuple[str, str], object] = {}
        for row in self.document if isinstance(self.document, list) else ():
            cells = (fields.cell(name, row) for name in (FRAME, CAMERA))
            frame, camera = (
                "" if cell is None else str(cell).strip() for cell in cells
            )
            rows[plain(frame), camera] = row
        return rows


def _key_in(entries: Mapping[str, object], value: str) -> str | None:
    if value in entries:
        return value
    same = plain(value)
    return next((key for key in entries if value and plain(str(key)) == same), None)
