"""Reads the camera and the other sensors of an annotation from JSON; collects faults.

`read_camera` returns a camera only if all of its keys are there and valid. It returns
the size of the image even without a camera, because 2D boxes need only that.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, TypeAlias

import numpy as np

from filter_core.annotation.boxes import box_place
from filter_core.annotation.frame import FORMS_3D
from filter_core.errors import FilterError
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform, read_transform
from filter_core.values import (
    Faults,
    Place,
    check_kept,
    check_kept_object,
    read_list,
    read_number,
    read_numbers,
    read_text,
    shown,
)

_Size: TypeAlias = tuple[int, int]

_Rows: TypeAlias = list[tuple[float, ...]]

_OPTICS: Final = ("fov", "intrinsic")

_POSES: Final = ("transform", "world_to_camera")

_KNOWN_KEYS: Final = frozenset({"name", "width", "height", *_OPTICS, *_POSES})


def camera_name(value: object, faults: Faults, longest: int) -> str | None:
    """What an annotation calls its camera, such as ``front``; None without a name."""
    if not isinstance(value, Mapping):
        return None
    return read_text(value.get("name"), Place() / "camera" / "name", faults, longest)


def read_camera(value: object, faults: Faults) -> tuple[Camera | None, _Size | None]:
    """The camera if all of it is given, and the size of its image; null is no camera.

    A matrix ``intrinsic`` can replace ``fov``, and a matrix ``world_to_camera``
    ``transform``. If neither key of a pair is given, only the size is returned.
    """
    if value is None:
        return None, None
    at = Place() / "camera"
    if not isinstance(value, Mapping):
        faults.add(at, "not_an_object", "an object", shown(value))
        return None, None
    before = len(faults)
    unknown = {key: value[key] for key in value if key not in _KNOWN_KEYS}
    check_kept(unknown, at, faults)
    width = _read_side(value.get("width"), at / "width", faults)
    height = _read_side(value.get("height"), at / "height", faults)
    optics = _only_one(value, _OPTICS, at, faults)
    pose = _only_one(value, _POSES, at, faults)
    fov_or_rows = (
        read_number(value["fov"], at / "fov", faults)
        if optics == "fov"
        else (_read_rows(value[optics], 3, at / optics, faults) if optics else None)
    )
    motion = (
        read_transform(value["transform"], at / "transform", faults)
        if pose == "transform"
        else (_read_rows(value[pose], 4, at / pose, faults) if pose else None)
    )
    if width is None or height is None:
        return None, None
    size = (width, height)
    if len(faults) > before or fov_or_rows is None or motion is None:
        return None, size
    return _build(size, fov_or_rows, motion, faults), size


def _read_side(value: object, at: Place, faults: Faults) -> int | None:
    if value is None:
        faults.add(at, "missing", "a number of pixels", "nothing")
        return None
    side = read_number(value, at, faults)
    if side is None:
        return None
    if side < 1 or side != int(side):
        faults.add(at, "bad_size", "a whole number of pixels from 1", shown(value))
        return None
    return int(side)


def _only_one(
    value: Mapping[str, object], keys: tuple[str, str], at: Place, faults: Faults
) -> str | None:
    given_keys = [key for key in keys if value.get(key) is not None]
    if len(given_keys) > 1:
        # If the two disagree, it is unknown which one is meant.
        faults.add(at, "contradiction", f"{keys[0]} or {keys[1]}", "both")
    return given_keys[0] if given_keys else None


def _read_rows(value: object, side: int, at: Place, faults: Faults) -> _Rows | None:
    rows = read_list(value, side, at, faults, of=f"rows of {side} numbers")
    if rows is None:
        return None
    read = [read_numbers(row, side, at / i, faults) for i, row in enumerate(rows)]
    number_rows = [row for row in read if row is not None]
    return number_rows if len(number_rows) == side else None


def _build(
    size: _Size, optics: float | _Rows, pose: Transform | _Rows, faults: Faults
) -> Camera | None:
    try:
        if isinstance(optics, float) and isinstance(pose, Transform):
            return Camera.from_fov(*size, optics, pose)
        intrinsic = (
            Camera.from_fov(*size, optics, Transform()).intrinsic
            if isinstance(optics, float)
            else np.array(optics)
        )
        motion = pose.inverse_matrix if isinstance(pose, Transform) else np.array(pose)
        return Camera.from_matrices(*size, intrinsic, motion)
    except FilterError as error:
        faults.take(error)
        return None


def require_camera(raw: Mapping[str, object], faults: Faults) -> None:
    """Add a fault if there are 3D boxes but the camera is incomplete.

    Only for a camera without faults of its own, because those say more.
    """
    boxes = raw.get("boxes")
    places = (
        box_place(index, box)
        for index, box in enumerate(boxes if isinstance(boxes, list | tuple) else ())
        if isinstance(box, Mapping) and not box.keys().isdisjoint(FORMS_3D)
    )
    if (first := next(places, None)) is None:
        return
    value = raw.get("camera")
    keys = _KNOWN_KEYS & value.keys() if isinstance(value, Mapping) else set()
    needed = "width, height, fov and transform (or intrinsic and world_to_camera)"
    names = ", ".join(sorted(keys)) or "nothing"
    expected = f"{needed} because {first.words} is 3D"
    faults.add(Place() / "camera", "missing_camera", expected, names)


def read_sensors(value: object, faults: Faults) -> dict[str, Transform | None]:
    """The poses of the sensors besides the camera by name; null is no sensors."""
    at = Place() / "sensors"
    check_kept_object(value, at, faults)
    entries = value if isinstance(value, Mapping) else {}
    sensors: dict[str, Transform | None] = {}
    for name, raw in entries.items():
        if not isinstance(raw, Mapping):
            faults.add(at / name, "not_an_object", "an object", shown(raw))
            continue
        pose = raw.get("transform")
        place = at / name / "transform"
        sensors[name] = None if pose is None else read_transform(pose, place, faults)
    return sensors
