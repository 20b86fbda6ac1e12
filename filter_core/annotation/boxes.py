"""Reads the boxes of an annotation from JSON, and collects every fault in them.

Faults are collected in a `Faults`, so that one pass finds all of them; a box with a
fault is not in the result.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from filter_core.annotation.frame import (
    BOX3D,
    GEOMETRIES,
    VERTICES,
    AnnotationLimits,
    BoxAnnotation,
)
from filter_core.geometry.pose import (
    Transform,
    Triple,
    read_rotation,
    read_transform,
    read_vector,
)
from filter_core.values import (
    BoxPlace,
    Faults,
    Place,
    check_kept,
    check_kept_object,
    plain_numbers,
    read_id,
    read_instance_id,
    read_list,
    read_number,
    read_numbers,
    read_text,
    shown,
)

KNOWN_BOX_KEYS: Final = frozenset(
    {"id", "class", "type_id", "base_type", "instance_id", "extra"}
    | {"distance", "distance_range"}
    | set(GEOMETRIES)
)
"""The keys of a box that have a meaning; all others are only kept."""

_BOX3D_KEYS: Final = ("transform", "location", "extent", "rotation")


def read_boxes(
    value: object, faults: Faults, limits: AnnotationLimits
) -> tuple[BoxAnnotation, ...]:
    """The boxes without a fault; the faults of all others are noted.

    `value` is what the annotation has under ``boxes``.
    """
    at = Place() / "boxes"
    if not isinstance(value, (list, tuple)):
        text = "nothing" if value is None else shown(value)
        faults.add(at, "missing_boxes", "a list of boxes", text)
        return ()
    if len(value) > limits.max_boxes:
        expected = f"at most {limits.max_boxes} boxes"
        faults.add(at, "too_many_boxes", expected, f"{len(value)}")
        return ()
    seen: dict[str, int] = {}
    boxes = [_read_box(raw, i, faults, limits, seen) for i, raw in enumerate(value)]
    return tuple(box for box in boxes if box is not None)


def box_place(index: int, raw: object) -> BoxPlace:
    """The place of a box, even if it is not an object."""
    return BoxPlace(index, raw.get("id") if isinstance(raw, Mapping) else None)


def _read_box(
    raw: object,
    index: int,
    faults: Faults,
    limits: AnnotationLimits,
    seen: dict[str, int],
) -> BoxAnnotation | None:
    at = box_place(index, raw)
    if not isinstance(raw, Mapping):
        faults.add(at, "not_an_object", "an object", shown(raw))
        return None
    before, longest = len(faults), limits.max_text
    box_id = read_id(raw.get("id"), index, at / "id", faults, longest)
    first = seen.setdefault(box_id, index)
    if first != index:
        expected = "an id that occurs once in the frame"
        text = f"{shown(box_id)} again, after box {first}"
        faults.add(at / "id", "duplicate_id", expected, text)
    names = [
        None if raw.get(key) is None else read_text(raw[key], at / key, faults, longest)
        for key in ("class", "type_id", "base_type")
    ]
    if raw.get("class") is None and raw.get("type_id") is None:
        faults.add(at / "class", "missing_class", "a class or a type_id", "neither")
    form, values = _read_geometry(raw, at, faults)
    distance, given_distance = None, raw.get("distance")
    if given_distance is not None:
        place = at / "distance"
        distance = read_number(given_distance, place, faults)
        if distance is not None and distance < 0:
            text = shown(given_distance)
            faults.add(place, "negative_distance", "metres from 0", text)
    instance_id = None
    if raw.get("instance_id") is not None:
        place = at / "instance_id"
        instance_id = read_instance_id(raw["instance_id"], place, faults)
    box = BoxAnnotation(
        id=box_id,
        index=index,
        class_name=names[0],
        type_id=names[1],
        base_type=names[2],
        form=form,
        values=values,
        distance=distance,
        instance_id=instance_id,
        raw=raw,
        distance_range=_read_distance_range(raw, at, faults),
    )
    check_extra(raw, KNOWN_BOX_KEYS, at, faults)
    return box if len(faults) == before else None


def _read_distance_range(
    raw: Mapping[str, object], at: Place, faults: Faults
) -> tuple[float, float] | None:
    value = raw.get("distance_range")
    if value is None:
        return None
    place = at / "distance_range"
    numbers = read_numbers(value, 2, place, faults)
    if numbers is None:
        return None
    low, high = numbers
    if not 0 <= low <= high:
        expected = "two distances, from 0, the nearer one first"
        faults.add(place, "bad_distance_range", expected, shown(value))
    return low, high


def check_extra(
    raw: Mapping[str, object], known_keys: frozenset[str], at: Place, faults: Faults
) -> None:
    """Adds faults of what exports write unchanged: ``extra``, and other keys.

    `raw` is the frame or the box as given; other keys are those not in `known_keys`.
    """
    check_kept_object(raw.get("extra"), at / "extra", faults)
    if not raw.keys() <= known_keys:
        unknown = {key: raw[key] for key in raw if key not in known_keys}
        check_kept(unknown, at, faults)


def _read_geometry(
    raw: Mapping[str, object], at: Place, faults: Faults
) -> tuple[str, tuple[float, ...]]:
    forms = [form for form in GEOMETRIES if form in raw]
    if len(forms) != 1:
        code = "several_geometries" if forms else "no_geometry"
        expected = f"exactly one of {', '.join(GEOMETRIES)}"
        faults.add(at, code, expected, " and ".join(forms) or "none")
        return "", ()
    form = forms[0]
    place = at / form
    if form == VERTICES:
        return form, _read_vertices(raw[form], place, faults)
    if form == BOX3D:
        return form, _read_box3d(raw[form], place, faults)
    return form, read_numbers(raw[form], 4, place, faults) or ()


def _read_vertices(value: object, at: Place, faults: Faults) -> tuple[float, ...]:
    # The usual case at once: 8 lists of 3 numbers without a fault
    if (
        isinstance(value, list)
        and len(value) == 8
        and all(type(corner) is list and len(corner) == 3 for corner in value)
    ):
        plain = plain_numbers(number for corner in value for number in corner)
        if plain is not None:
            return plain
    corners = read_list(value, 8, at, faults, of="points")
    if corners is None:
        return ()
    read = [read_vector(corner, at / i, faults) for i, corner in enumerate(corners)]
    return tuple(number for corner in read if corner for number in corner)


def _read_box3d(value: object, at: Place, faults: Faults) -> tuple[float, ...]:
    if not isinstance(value, Mapping):
        faults.add(at, "not_an_object", "an object", shown(value))
        return ()
    for key in value.keys() - set(_BOX3D_KEYS):
        expected = f"only {', '.join(_BOX3D_KEYS)}"
        faults.add(at / key, "unknown_key", expected, shown(value[key]))
    # Without a transform the box is given in the world, as get_level_bbs does.
    transform = value.get("transform")
    read = (
        None
        if transform is None
        else read_transform(transform, at / "transform", faults)
    )
    actor = read or Transform()
    extent: Triple = (0.0, 0.0, 0.0)
    if "extent" in value:
        extent = read_vector(value["extent"], at / "extent", faults) or extent
    else:
        faults.add(at / "extent", "missing", "half sizes {x, y, z}", "nothing")
    parts = [
        actor.location,
        actor.rotation,
        _read_optional(value, "location", at, faults),
        extent,
        _read_optional(value, "rotation", at, faults),
    ]
    return tuple(number for part in parts for number in part)


def _read_optional(
    value: Mapping[str, object], key: str, at: Place, faults: Faults
) -> Triple:
    raw = value.get(key)
    read = read_rotation if key == "rotation" else read_vector
    triple = None if raw is None else read(raw, at / key, faults)
    return triple or (0.0, 0.0, 0.0)
