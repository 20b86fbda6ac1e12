"""Vectors and poses in the forms in which people's files have them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

ROTATION: Final = ("pitch", "yaw", "roll")


def vector_of(value: object, keys: Sequence[str]) -> dict[str, float]:
    """An object with these keys, in any case, or a list, as an object of numbers.

    Of a rotation, keys may be missing, and a number alone is its yaw.

    Raises
    ------
    ValueError
        It is none; says what was expected.
    """
    is_rotation = tuple(keys) == ROTATION
    expected = f"{{{', '.join(keys)}}} or a list of {len(keys)} numbers"
    if is_rotation and _is_plain_number(value):
        value = {"yaw": value}
    if isinstance(value, Mapping):
        own = {str(key).lower(): item for key, item in value.items()}
        items = [own.get(key, 0.0 if is_rotation else None) for key in keys]
        if is_rotation and not own.keys() & {*keys} and own:
            raise ValueError(expected)
    else:
        items = value if isinstance(value, list) else []
    if len(items) != len(keys):
        raise ValueError(expected)
    numbers = [as_number(item) for item in items]
    if not all(map(math.isfinite, numbers)):
        raise ValueError(expected)
    return dict(zip(keys, numbers, strict=True))


_LOCATIONS: Final = ("location", "translation", "position")


def transform_of(value: object) -> dict[str, float]:
    """Where something stands: x, y, z, pitch, yaw and roll.

    From an object with these keys, or with a location (``translation``, ``position``)
    and a rotation, in any case.

    Raises
    ------
    ValueError
        It is none; says what was expected.
    """
    if not isinstance(value, Mapping):
        raise ValueError("an object with a location and a rotation")
    own = {str(key).lower(): item for key, item in value.items()}
    place = next((own[name] for name in _LOCATIONS if name in own), None)
    if place is not None:
        location, rotation = vector_of(place, "xyz"), own.get("rotation")
        return {**location, **vector_of(rotation or {}, ROTATION)}
    rotation = {name: own[name] for name in ROTATION if name in own}
    return {**vector_of(own, "xyz"), **vector_of(rotation, ROTATION)}


def as_number(value: object) -> float:
    """A number, also one that is written as text; NaN if it is none."""
    try:
        return float(value) if isinstance(value, int | float | str) else math.nan
    except ValueError:
        return math.nan


def _is_plain_number(value: object) -> bool:
    return isinstance(value, int | float | str) and not isinstance(value, bool)
