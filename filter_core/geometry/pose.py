"""Positions and rotations in CARLA's left-handed world, and reading them from JSON.

Metres and degrees; x forward, y right, z up. `Transform` and the functions that end in
``matrices`` do the mathematics; `as_transform` and the ``read_...`` functions read the
objects and lists that annotations contain, and report every fault in them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from filter_core.arrays import FloatArray
from filter_core.values import (
    Faults,
    Place,
    plain_numbers,
    read_number,
    read_numbers,
    shown,
)

Triple: TypeAlias = tuple[float, float, float]

_ZERO: Final[Triple] = (0.0, 0.0, 0.0)

_VECTOR_KEYS: Final = ("x", "y", "z")

_ROTATION_KEYS: Final = ("pitch", "yaw", "roll")

_NOT_TURNED: Final[Mapping[str, float]] = dict.fromkeys(_ROTATION_KEYS, 0.0)


@dataclass(frozen=True)
class Transform:
    """A location (x, y, z), metres, and a rotation (pitch, yaw, roll), degrees."""

    location: Triple = _ZERO
    rotation: Triple = _ZERO

    @property
    def matrix(self) -> FloatArray:
        """(4, 4): local to world."""
        matrix: FloatArray = transform_matrices([self.location], [self.rotation])[0]
        return matrix

    @property
    def inverse_matrix(self) -> FloatArray:
        """(4, 4): world to local, exact for a rigid motion."""
        # (4, 4): the inverse of a rotation and a shift
        turned = self.matrix[:3, :3].T
        inverse = np.eye(4)
        inverse[:3, :3] = turned
        inverse[:3, 3] = -turned @ self.matrix[:3, 3]
        return inverse

    def as_dict(self) -> dict[str, float]:
        """Its six numbers by their names, ready for JSON."""
        names = (*_VECTOR_KEYS, *_ROTATION_KEYS)
        return dict(zip(names, (*self.location, *self.rotation), strict=True))


TransformLike: TypeAlias = Transform | Mapping[str, object]


def rotation_matrices(rotations: ArrayLike) -> FloatArray:
    """(N, 3, 3) float64: CARLA's rotation matrices of N rotations.

    `rotations`, (N, 3), are pitch, yaw, roll in degrees. The matrices map local vectors
    to world vectors; determinant +1.

    References
    ----------
    .. [1] CARLA client, ``carla.Transform.get_matrix`` (0.9.12 to 0.9.16 agree).
    """
    radians = np.deg2rad(np.asarray(rotations, dtype=np.float64).reshape(-1, 3))
    cp, cy, cr = np.cos(radians).T
    sp, sy, sr = np.sin(radians).T
    rows = np.array(
        [
            [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr],
            [cp * sy, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr],
            [sp, -cp * sr, cp * cr],
        ]
    )
    return np.moveaxis(rows, -1, 0)


def transform_matrices(locations: ArrayLike, rotations: ArrayLike) -> FloatArray:
    """(N, 4, 4) float64, local to world, of (N, 3) locations and (N, 3) rotations."""
    turned = rotation_matrices(rotations)
    matrices = np.zeros((len(turned), 4, 4))
    matrices[:, :3, :3] = turned
    matrices[:, :3, 3] = np.asarray(locations, dtype=np.float64).reshape(-1, 3)
    matrices[:, 3, 3] = 1.0
    return matrices


def as_transform(value: TransformLike) -> Transform:
    """A `Transform` from itself or from an object that describes it.

    Raises `AnnotationErrors`: every fault of the object.
    """
    if isinstance(value, Transform):
        return value
    faults = Faults()
    read = read_transform(value, Place() / "transform", faults)
    faults.raise_any()
    return read or Transform()


def read_vector(value: object, at: Place, faults: Faults) -> Triple | None:
    """``{x, y, z}`` or ``[x, y, z]``, or None and faults."""
    return _read_triple(value, at, faults, _VECTOR_KEYS)


def read_rotation(value: object, at: Place, faults: Faults) -> Triple | None:
    """``{pitch, yaw, roll}`` (an absent one is 0) or a list; or None and faults."""
    if isinstance(value, Mapping):
        value = {**_NOT_TURNED, **value}
    return _read_triple(value, at, faults, _ROTATION_KEYS)


def read_transform(value: object, at: Place, faults: Faults) -> Transform | None:
    """Six numbers in one object, or ``{location, rotation}``; or None and faults."""
    if not isinstance(value, Mapping):
        faults.add(at, "not_an_object", "an object (a transform)", shown(value))
        return None
    if "location" in value or "rotation" in value:
        _refuse_unknown(value, ("location", "rotation"), at, faults)
        # Without a location the origin would be a silent guess, so it must be there.
        location = read_vector(value.get("location"), at / "location", faults)
        turned = value.get("rotation", _NOT_TURNED)
        rotation = read_rotation(turned, at / "rotation", faults)
    else:
        _refuse_unknown(value, (*_VECTOR_KEYS, *_ROTATION_KEYS), at, faults)
        location = _read_keys(value, at, faults, _VECTOR_KEYS)
        completed = {**_NOT_TURNED, **value}
        rotation = _read_keys(completed, at, faults, _ROTATION_KEYS)
    if location is None or rotation is None:
        return None
    return Transform(location, rotation)


def _read_triple(
    value: object, at: Place, faults: Faults, keys: tuple[str, ...]
) -> Triple | None:
    if isinstance(value, Mapping):
        _refuse_unknown(value, keys, at, faults)
        return _read_keys(value, at, faults, keys)
    if not isinstance(value, (list, tuple, np.ndarray)):
        expected = f"{{{', '.join(keys)}}} or a list of 3 numbers"
        faults.add(at, "not_a_vector", expected, shown(value))
        return None
    numbers = read_numbers(value, 3, at, faults)
    return None if numbers is None else (numbers[0], numbers[1], numbers[2])


def _read_keys(
    value: Mapping[str, object], at: Place, faults: Faults, keys: tuple[str, ...]
) -> Triple | None:
    plain = plain_numbers(map(value.get, keys))
    if plain is not None:
        return plain[0], plain[1], plain[2]
    read: list[float] = []
    for key in keys:
        if key not in value:
            faults.add(at / key, "missing", "a number", "nothing")
            continue
        number = read_number(value[key], at / key, faults)
        if number is not None:
            read.append(number)
    return (read[0], read[1], read[2]) if len(read) == 3 else None


def _refuse_unknown(
    value: Mapping[str, object], keys: tuple[str, ...], at: Place, faults: Faults
) -> None:
    # A misspelt "yall" would otherwise turn the box back to yaw 0 in silence.
    if value.keys() <= set(keys):
        return
    for key in value:
        if key not in keys:
            expected = f"only {', '.join(keys)}"
            faults.add(at / key, "unknown_key", expected, shown(value[key]))
