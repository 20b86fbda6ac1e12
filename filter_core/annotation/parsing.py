"""Parses and checks the JSON of one frame's annotation; finds all faults in one pass.

`parse_annotation` takes JSON, or the mapping it decodes to, and returns a
`FrameAnnotation`, or raises all faults, each with its place. JSON is read more strictly
than Python does: a key that occurs twice is a fault, because one of its values would be
lost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import partial
from typing import Final

from filter_core.annotation.boxes import box_place, check_extra, read_boxes
from filter_core.annotation.camera import (
    camera_name,
    read_camera,
    read_sensors,
    require_camera,
)
from filter_core.annotation.frame import AnnotationLimits, FrameAnnotation
from filter_core.errors import JsonError
from filter_core.json_text import JsonLimits, read_json
from filter_core.values import (
    Faults,
    Place,
    check_kept_object,
    is_encodable,
    read_text,
    read_time,
    shown,
)

KNOWN_FRAME_KEYS: Final = frozenset(
    {
        "boxes",
        "camera",
        "captured_at",
        "carla_version",
        "extra",
        "map",
        "sensors",
        "sequence",
        "split",
        "weather",
    }
)

_DEFAULT_LIMITS: Final = AnnotationLimits()


def parse_annotation(
    raw: Mapping[str, object] | bytes | str,
    *,
    limits: AnnotationLimits = _DEFAULT_LIMITS,
    frame: str = "",
) -> FrameAnnotation:
    """The annotation of one frame, read and checked.

    Null is the same as an absent key, except in a geometry. Unknown keys are checked,
    too, and are in `raw`, of the frame and of each box.

    Parameters
    ----------
    raw : mapping, or JSON as bytes (UTF-8) or text
        Never changed. A key that JSON repeats is an error, as is NaN or Infinity.
    frame : str
        The frame's key; errors name it.

    Raises
    ------
    AnnotationErrors
        Every fault at once, each with its JSON pointer, a stable code, and a text that
        names the box (index and id), the field, what was expected and what was found.
    """
    faults = Faults(frame)
    document: object = raw
    if isinstance(raw, (bytes, str)):
        document = _decode_json(raw, faults, limits.json)
    if not isinstance(document, Mapping):
        faults.add(Place(), "not_an_object", "an object", shown(document))
        raise faults.as_error()
    at = Place()
    before = len(faults)
    camera, camera_wh = read_camera(document.get("camera"), faults)
    camera_faults = len(faults) - before
    version, town, sequence, split = (
        read_text(document.get(key), at / key, faults, limits.max_text)
        for key in ("carla_version", "map", "sequence", "split")
    )
    captured_at = read_time(document.get("captured_at"), at / "captured_at", faults, 64)
    boxes = read_boxes(document.get("boxes"), faults, limits)
    if camera is None and camera_faults == 0:
        require_camera(document, faults)
    check_kept_object(document.get("weather"), at / "weather", faults)
    sensors = read_sensors(document.get("sensors"), faults)
    check_extra(document, KNOWN_FRAME_KEYS, at, faults)
    annotation = FrameAnnotation(
        boxes=boxes,
        camera=camera,
        camera_wh=camera_wh,
        carla_version=version,
        captured_at=captured_at,
        map=town,
        camera_name=camera_name(document.get("camera"), faults, limits.max_text),
        sensors=sensors,
        sequence=sequence,
        split=split,
        raw=document,
    )
    faults.raise_any()
    return annotation


def without_key(
    raw: bytes, name: str, limits: AnnotationLimits = _DEFAULT_LIMITS
) -> tuple[str, Mapping[str, object] | bytes]:
    """The frame's key, taken from its annotation, and the annotation without it.

    If the annotation has no ``key``, is no object, or has a key twice, the result is
    `name` and the annotation as given: `parse_annotation` reports the error.

    Raises
    ------
    AnnotationErrors
        ``bad_key``: the key is not a text, or cannot be encoded as UTF-8.
        ``not_json``, ``json_too_large``: it is not JSON, or beyond the limits.
    """
    faults = Faults(name)
    document = _decode_json(raw, faults, limits.json)
    if len(faults) or not isinstance(document, Mapping) or "key" not in document:
        return name, raw
    rest = dict(document)
    key = rest.pop("key")
    if not isinstance(key, str) or not is_encodable(key):
        expected = "a text without NUL and halves of surrogate pairs"
        faults.add(Place() / "key", "bad_key", expected, shown(key))
        raise faults.as_error()
    return key, rest


class _Repeating(dict[str, object]):
    """An object with repeated keys, of which `json` would silently keep the last."""

    repeated: tuple[str, ...] = ()


def _decode_json(raw: bytes | str, faults: Faults, limits: JsonLimits) -> object:
    """The document; repeated keys are noted, NaN and Infinity left to their field."""
    repeating: list[_Repeating] = []
    try:
        document = read_json(
            raw, limits, object_pairs_hook=partial(_object_of, repeating), halves=True
        )
    except JsonError as error:
        faults.add(Place(), error.kind, "JSON in UTF-8", error.found)
        raise faults.as_error() from error
    if repeating:
        _note_repeated(document, Place(), faults)
    return document


def _object_of(
    repetitions: list[_Repeating], pairs: list[tuple[str, object]]
) -> dict[str, object]:
    plain = dict(pairs)
    if len(plain) == len(pairs):
        return plain
    repeating = _Repeating(plain)
    times = Counter(key for key, _ in pairs)
    repeating.repeated = tuple(key for key, count in times.items() if count > 1)
    repetitions.append(repeating)
    return repeating


def _note_repeated(value: object, at: Place, faults: Faults) -> None:
    if isinstance(value, _Repeating):
        for key in value.repeated:
            expected = "a key that occurs once"
            faults.add(at / key, "duplicate_key", expected, f"{shown(key)} twice")
    if isinstance(value, Mapping):
        for key, item in value.items():
            _note_repeated(item, at / key, faults)
    elif isinstance(value, list):
        is_boxes = at.is_boxes
        for index, item in enumerate(value):
            place = box_place(index, item) if is_boxes else at / index
            _note_repeated(item, place, faults)
