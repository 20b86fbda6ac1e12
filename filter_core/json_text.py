"""Reads untrusted JSON in linear time; its limits are checked before it is parsed.

`read_json` takes bytes or text and returns one parsed value. Size, depth, the number of
values and of keys, and the length of numbers are checked in the bytes first
(`check_limits`), so that a document beyond a limit costs neither memory nor time.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.errors import JsonError

_Pairs: TypeAlias = list[tuple[str, object]]


@dataclass(frozen=True)
class JsonLimits:
    """How much one JSON document may hold.

    Attributes
    ----------
    max_bytes : int
        Of its UTF-8.
    max_depth : int
        Lists and objects inside of each other.
    max_values : int
        Numbers, texts, lists, objects and the like, in all. Empty lists and objects
        count twice.
    max_keys : int
        Keys of all objects.
    """

    max_bytes: int = 64 << 20
    max_depth: int = 64
    max_values: int = 500_000
    max_keys: int = 500_000


_DEFAULT_LIMITS: Final = JsonLimits()

_BYTES_PER_VALUE: Final = 2
"""``1,``: a shorter document cannot hold more values."""

_NO_SIGNS: Final = bytes(sorted(set(range(256)) - set(b'[]{},:"')))

_STEPS: Final = np.zeros(256, np.int8)

_STEPS[list(b"[{")], _STEPS[list(b"]}")] = 1, -1
"""The change of depth after each bracket."""

_LONGEST_NUMBER: Final = 100

_LONG_DIGITS: Final = b"0" * (_LONGEST_NUMBER + 1)

LONG_NUMBER: Final = f"a number of more than {_LONGEST_NUMBER} characters"
"""What error messages name as found."""

_AS_DIGITS: Final = bytes(
    ord("0" if code in b"+-.0123456789Ee" else " ") for code in range(256)
)
"""Replaces every character of a number by 0."""

_ANY_HALF: Final = re.compile(r"\\u[dD][89a-fA-F]")

_ESCAPES: Final = re.compile(
    r"\\(?:u[dD][89abAB][0-9a-fA-F]{2}\\u[dD][c-fC-F][0-9a-fA-F]{2}"
    r"|(?P<half>u[dD][89a-fA-F][0-9a-fA-F]{2})|.)",
    re.DOTALL,
)
"""An escape, or the two of a surrogate pair; `half` is one without its other half."""


def repeated_key(pairs: _Pairs) -> str | None:
    """The first key that occurs twice in an object; None if each occurs once.

    For an `object_pairs_hook`: of two values under one key, JSON ignores the first.
    """
    seen: set[str] = set()
    for key, _ in pairs:
        if key in seen:
            return key
        seen.add(key)
    return None


def read_json(
    raw: bytes | str,
    limits: JsonLimits = _DEFAULT_LIMITS,
    *,
    object_pairs_hook: Callable[[_Pairs], object] | None = None,
    halves: bool = False,
) -> object:
    """One value from a JSON document.

    ``NaN``, ``Infinity`` and numbers beyond the range of a float are floats that are
    not finite; the code that uses the number refuses it.

    Parameters
    ----------
    raw : bytes (UTF-8, with or without a mark at its beginning) or text
    object_pairs_hook : callable, optional
        Makes an object of its keys and values, as for `json.loads`.
    halves : bool
        Let halves of surrogate pairs pass, for a reader that names their field.

    Raises
    ------
    JsonError
        ``not_json``: it is not JSON, not in UTF-8, a text in it cannot be encoded as
        UTF-8, or a number has more than 100 characters.
        ``json_too_large``: it is beyond a limit; no value was made.

    Notes
    -----
    Limits are looked at in the bytes, before any value is made: counting commas and
    brackets takes a fraction of the time, and none of the memory, of parsing them.
    """
    content = raw.encode("utf-8", "surrogatepass") if isinstance(raw, str) else raw
    check_limits(content, limits)
    try:
        text = raw.decode("utf-8-sig") if isinstance(raw, bytes) else raw
        if not halves:
            _refuse_halves(text)
        document: object = json.loads(text, object_pairs_hook=object_pairs_hook)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise JsonError(f"a fault at {place}: {error.msg}") from error
    except UnicodeDecodeError as error:
        raise JsonError(f"other bytes at offset {error.start}") from error
    except RecursionError as error:
        raise _too_deep(limits) from error
    except JsonError:
        raise
    except ValueError as error:
        # Raised by `object_pairs_hook`.
        raise JsonError(str(error)) from error
    return document


def check_limits(content: bytes, limits: JsonLimits = _DEFAULT_LIMITS) -> None:
    """Raise a `JsonError` if a document is beyond a limit; nothing is parsed."""
    if len(content) > limits.max_bytes:
        text = f"JSON of more than {limits.max_bytes} bytes"
        raise JsonError(text, code="json_too_large")
    may_have_many = len(content) >= _BYTES_PER_VALUE * min(
        limits.max_values, limits.max_keys
    )
    if may_have_many and (
        _values_at_most(content) > limits.max_values
        or content.count(b":") > limits.max_keys
    ):
        # Characters inside strings were counted as well: count again without strings.
        signs = _signs_of(content)
        if _values_at_most(signs) > limits.max_values:
            text = f"JSON of more than {limits.max_values} values"
            raise JsonError(text, code="json_too_large")
        if signs.count(b":") > limits.max_keys:
            text = f"JSON of more than {limits.max_keys} keys"
            raise JsonError(text, code="json_too_large")
    steps = _STEPS[np.frombuffer(_signs_of(content), np.uint8)]
    if int(np.cumsum(steps, dtype=np.int32).max(initial=0)) > limits.max_depth:
        raise _too_deep(limits)
    start = find_long_number(content)
    if start is not None:
        position = len(content[:start].decode("utf-8-sig", "replace"))
        raise JsonError(f"{LONG_NUMBER}, at character {position}")


def find_long_number(content: bytes) -> int | None:
    """Where a number of more than 100 characters begins in JSON; None if there is none.

    Parsing one takes time by the square of its length, and no other thread runs
    meanwhile. The searched bytes may end anywhere, but must not begin inside a text.
    """
    digits = content.translate(_AS_DIGITS)
    start = digits.find(_LONG_DIGITS)
    if start < 0:
        return None
    # An escape does not end a string; the replacement is as long, so positions stay.
    content = content.replace(b"\\\\", b"  ").replace(b'\\"', b"  ")
    quotes = seen = 0
    while start >= 0:
        quotes += content.count(b'"', seen, start)
        if quotes % 2 == 0:
            return start
        seen = content.find(b'"', start)
        start = digits.find(_LONG_DIGITS, seen) if seen >= 0 else -1
    return None


def _too_deep(limits: JsonLimits) -> JsonError:
    text = f"JSON that is nested deeper than {limits.max_depth} levels"
    return JsonError(text, code="json_too_large")


def _values_at_most(content: bytes) -> int:
    return 1 + content.count(b",") + content.count(b"[") + content.count(b"{")


def _signs_of(content: bytes) -> bytes:
    """Brackets, commas and colons outside of strings, in order.

    If the document is not JSON, the result may be wrong from the error on, where
    parsing ends.
    """
    if b"\\" in content:
        content = content.replace(b"\\\\", b"").replace(b'\\"', b"")
    codes = np.frombuffer(content.translate(None, _NO_SIGNS), np.uint8)
    is_inside = np.cumsum(codes == ord('"'), dtype=np.uint8) & 1
    outside: NDArray[np.uint8] = codes[is_inside == 0]
    return outside.tobytes()


def _refuse_halves(text: str) -> None:
    if _ANY_HALF.search(text) is None:
        return
    for escape in _ESCAPES.finditer(text):
        if escape["half"] is not None:
            half = f"half of a surrogate pair, {escape[0]}"
            raise JsonError(f"{half}, at character {escape.start()}")
