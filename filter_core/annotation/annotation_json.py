"""Decodes the JSON of an annotation: stricter than Python, so that nothing is lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import partial

from filter_core.annotation.boxes import box_place
from filter_core.errors import JsonError
from filter_core.json_text import JsonLimits, read_json
from filter_core.values import Faults, Place, shown


class _Repeating(dict[str, object]):
    """An object that named some of its keys twice; JSON keeps the last in silence."""

    repeated: tuple[str, ...] = ()


def decode_json(raw: bytes | str, faults: Faults, limits: JsonLimits) -> object:
    """The document; repeated keys are noted, NaN and Infinity are left to their field.

    Raises
    ------
    AnnotationErrors
        ``not_json``, ``json_too_large``: as `read_json`, which reads it.
    """
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
    found: list[_Repeating], pairs: list[tuple[str, object]]
) -> dict[str, object]:
    plain = dict(pairs)
    if len(plain) == len(pairs):
        return plain
    repeating = _Repeating(plain)
    times = Counter(key for key, _ in pairs)
    repeating.repeated = tuple(key for key, count in times.items() if count > 1)
    found.append(repeating)
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
