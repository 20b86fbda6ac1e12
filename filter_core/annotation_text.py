"""Texts, identifiers and kept values of an annotation: what may be stored, what not."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Mapping
from datetime import datetime
from typing import Final

from filter_core.values import Faults, Place, shown

MAX_INTEGER: Final = 2**63 - 1
"""Ids beyond it fit no database column."""

_MAX_DEPTH: Final = 32
"""Deeper JSON exhausts the stack of whatever reads it next."""


def read_text(value: object, at: Place, faults: Faults, limit: int) -> str | None:
    """A text that can be shown and stored, or None; null is None without a fault."""
    if value is None:
        return None
    if not isinstance(value, str):
        faults.add(at, "not_a_text", "a text", shown(value))
    elif not value.strip():
        faults.add(at, "empty", "a text that is not empty", shown(value))
    elif len(value) > limit:
        expected = f"at most {limit} characters"
        faults.add(at, "text_too_long", expected, f"{len(value)} characters")
    elif not is_storable(value):
        expected = "a text without control characters"
        faults.add(at, "control_character", expected, shown(value))
    else:
        return value
    return None


def is_storable(text: str) -> bool:
    """No control characters and no halves of surrogate pairs."""
    return text.isprintable() or not any(
        unicodedata.category(character) in ("Cc", "Cs") for character in text
    )


def read_id(value: object, index: int, at: Place, faults: Faults, limit: int) -> str:
    """The box's id as text; the index where none is given or it cannot be used."""
    if value is None:
        return str(index)
    if isinstance(value, int) and not isinstance(value, bool):
        if abs(value) <= MAX_INTEGER:
            return str(value)
        faults.add(at, "number_too_large", "an id of at most 64 bits", shown(value))
    elif isinstance(value, str):
        return read_text(value, at, faults, limit) or str(index)
    else:
        faults.add(at, "bad_id", "a text or an integer", shown(value))
    return str(index)


def read_instance_id(value: object, at: Place, faults: Faults) -> int | None:
    """An integer from 0, or None and a fault."""
    if isinstance(value, bool) or not isinstance(value, int):
        faults.add(at, "not_an_integer", "an integer", shown(value))
        return None
    if not 0 <= value <= MAX_INTEGER:
        faults.add(at, "out_of_range", "an integer from 0 to 2^63 - 1", shown(value))
        return None
    return value


def read_time(value: object, at: Place, faults: Faults, limit: int) -> str | None:
    """An RFC 3339 time as given, or None; null is None without a fault."""
    text = read_text(value, at, faults, limit)
    if text is None:
        return None
    try:
        moment = datetime.fromisoformat(_python_iso(text))
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None:
        expected = "an RFC 3339 time such as 2026-01-01T00:00:00Z"
        faults.add(at, "bad_time", expected, shown(text))
        return None
    return text


def _python_iso(text: str) -> str:
    # Python 3.10 reads neither "Z" nor fractions other than 3 or 6 digits.
    utc = text[:-1] + "+00:00" if text[-1:] in "Zz" else text
    head, dot, tail = utc.partition(".")
    digits = len(tail) - len(tail.lstrip("0123456789"))
    return f"{head}.{tail[:digits][:6]:0<6}{tail[digits:]}" if dot and digits else utc


def read_kept_object(value: object, at: Place, faults: Faults) -> dict[str, object]:
    """An object that is kept and given back as it is; null is an empty one."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        faults.add(at, "not_an_object", "an object", shown(value))
        return {}
    check_kept(value, at, faults)
    return dict(value)


def check_kept(value: object, at: Place, faults: Faults, depth: int = 0) -> None:
    """Faults of a value that is kept unread: it must come back as valid JSON."""
    if depth > _MAX_DEPTH:
        expected = f"at most {_MAX_DEPTH} levels of nesting"
        faults.add(at, "nested_too_deeply", expected, "more")
    elif isinstance(value, Mapping):
        for key, item in value.items():
            _check_key(key, at, faults)
            if not _is_plain(item):
                check_kept(item, at / str(key), faults, depth + 1)
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            if not _is_plain(item):
                check_kept(item, at / index, faults, depth + 1)
    else:
        _check_leaf(value, at, faults)


def _is_plain(value: object) -> bool:
    """The usual leaf, at once: there may be hundreds of thousands."""
    if isinstance(value, float):
        return math.isfinite(value)
    return value is None or isinstance(value, int)


def _check_key(key: object, at: Place, faults: Faults) -> None:
    if not isinstance(key, str) or not is_storable(key):
        expected = "keys that are texts without control characters"
        faults.add(at, "bad_key", expected, shown(key))


def _check_leaf(value: object, at: Place, faults: Faults) -> None:
    if _is_plain(value):
        return
    if isinstance(value, float):
        faults.add(at, "not_finite", "a finite number", shown(value))
    elif not isinstance(value, str):
        faults.add(at, "not_json", "a JSON value", shown(value))
    elif not is_encodable(value):
        expected = "a text without NUL and halves of surrogate pairs"
        faults.add(at, "control_character", expected, shown(value))


def is_encodable(text: str) -> bool:
    """No NUL and no halves of surrogate pairs."""
    # Line breaks are fine in a kept text; these two no database column takes.
    if text.isascii():
        return "\0" not in text
    try:
        return b"\0" not in text.encode()
    except UnicodeEncodeError:
        return False
