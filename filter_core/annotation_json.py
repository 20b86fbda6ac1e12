"""Decodes the JSON of an annotation: stricter than Python, so that nothing is lost."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial

from filter_core.annotation_boxes import box_place
from filter_core.faults import Faults, Place, shown


class _Repeating(dict[str, object]):
    """An object that named some of its keys twice; JSON keeps the last in silence."""

    repeated: tuple[str, ...] = ()


def decode_json(raw: bytes | str, faults: Faults) -> object:
    """The document; repeated keys are noted, NaN and Infinity are left to their field.

    Raises
    ------
    AnnotationErrors
        ``not_json``: it is not JSON, or not in UTF-8.
    """
    try:
        text = raw.decode("utf-8-sig") if isinstance(raw, bytes) else raw
        repeating: list[_Repeating] = []
        document = json.loads(text, object_pairs_hook=partial(_object_of, repeating))
        if repeating:
            _note_repeated(document, Place(), faults)
    except (ValueError, RecursionError) as error:
        faults.add(Place(), "not_json", "JSON in UTF-8", fault_of(error))
        raise faults.as_error() from error
    return document


def _object_of(
    found: list[_Repeating], pairs: list[tuple[str, object]]
) -> dict[str, object]:
    plain = dict(pairs)
    if len(plain) == len(pairs):
        return plain
    repeating = _Repeating(plain)
    keys = [key for key, _ in pairs]
    repeating.repeated = tuple(key for key in plain if keys.count(key) > 1)
    found.append(repeating)
    return repeating


def fault_of(error: Exception) -> str:
    """What was found where JSON was expected, as reading it says."""
    if isinstance(error, json.JSONDecodeError):
        return f"a fault at line {error.lineno}, column {error.colno}: {error.msg}"
    if isinstance(error, UnicodeDecodeError):
        return f"other bytes at offset {error.start}"
    if isinstance(error, RecursionError):
        return "JSON that is nested too deeply"
    return "a number of too many digits"


def _note_repeated(value: object, at: Place, faults: Faults) -> None:
    if isinstance(value, _Repeating):
        for key in value.repeated:
            expected = "a key that occurs once"
            faults.add(at / key, "duplicate_key", expected, f"{shown(key)} twice")
    if isinstance(value, Mapping):
        for key, item in value.items():
            _note_repeated(item, at / key, faults)
    elif isinstance(value, list):
        is_boxes = at.pointer == "/boxes"
        for index, item in enumerate(value):
            place = box_place(index, item) if is_boxes else at / index
            _note_repeated(item, place, faults)
