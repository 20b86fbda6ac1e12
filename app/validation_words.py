"""What pydantic found wrong with a value, in the words of all other messages."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

_KINDS: Final[tuple[tuple[type | tuple[type, ...], str], ...]] = (
    (bool, "true or false"),
    ((int, float), "a number"),
    (str, "a text"),
    (Mapping, "an object"),
    ((list, tuple), "a list"),
    (type(None), "null"),
)
_EXPECTED: Final[Mapping[str, str]] = {
    "model_attributes_type": "an object",
    "model_type": "an object",
    "dict_type": "an object",
    "string_type": "a text",
    "list_type": "a list",
    "tuple_type": "a list",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_parsing_size": "a whole number that is not so large",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "timezone_aware": "a time with its zone, such as 2026-01-31T12:00:00Z",
    "datetime_type": "a time such as 2026-01-31T12:00:00Z",
    "datetime_parsing": "a time such as 2026-01-31T12:00:00Z",
    "datetime_from_date_parsing": "a time such as 2026-01-31T12:00:00Z",
    "byte_size": "a size such as 64MiB",
    "literal_error": "{expected}",
    "enum": "{expected}",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "string_too_short": "at least {min_length} characters",
    "string_too_long": "at most {max_length} characters",
    "too_short": "at least {min_length} items",
    "too_long": "at most {max_length} items, found {actual_length}",
}
_PATTERNS: Final[Mapping[str, str]] = {
    r"^[a-z0-9](?:[a-z0-9._-]{0,98}[a-z0-9])?$": "1 to 100 of a-z, 0-9, dot, dash and "
    "underscore, with a letter or a digit at both ends",
    r"^[0-9a-f]{64}$": "a digest of 64 hexadecimal digits",
    r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]*[^\s\x00-\x1f\x7f-\x9f]$": "printable "
    "characters, and no space at the end",
    r"^[^\x00-\x1f\x7f]+$": "characters that can be printed",
    r"^[^\x00]*$": "characters other than NUL",
    r"^((kept|rejected|unmeasured)(,(kept|rejected|unmeasured))*)?$": "kept, rejected "
    "and unmeasured, separated by commas",
    r"^[0-9]+$": "digits",
    r"^[a-z0-9-]{1,40}$": "1 to 40 of a-z, 0-9 and dash",
}
_NUMBER: Final = re.compile(r"[+-]?\d{1,20}(\.\d{1,20})?")


def in_words(error: Mapping[str, Any], *, show: bool = False) -> str:
    """One of pydantic's errors: what was expected, and what kind of thing was found.

    Texts are shown only to whoever wrote them here: one in a request may be a token.
    """
    kind, context = str(error["type"]), error.get("ctx") or {}
    if kind == "missing":
        return "expected, but not there"
    if kind == "extra_forbidden":
        return "there is nothing of this name; it may be misspelt"
    if kind == "value_error":
        return str(error["msg"]).removeprefix("Value error, ")
    expected = _expected(kind, context)
    if expected is None:
        return str(error["msg"])
    # What a text should have been says more than that it is one.
    about_words = kind in ("string_pattern_mismatch", "literal_error", "enum")
    is_text = about_words and isinstance(error.get("input"), str)
    if (is_text and not show) or "found" in expected:
        return f"expected {expected}"
    return f"expected {expected}, found {_found(error.get('input'), show)}"


def _expected(kind: str, context: Mapping[str, Any]) -> str | None:
    if kind == "string_pattern_mismatch":
        return _PATTERNS.get(str(context.get("pattern")))
    words = _EXPECTED.get(kind)
    return None if words is None else words.format_map(context)


def _found(value: object, show: bool) -> str:
    if isinstance(value, str) and (show or _NUMBER.fullmatch(value)):
        return repr(value[:60]) if show else value
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return f"{value:.15g}" if isinstance(value, float) else str(value)[:40]
    names = (name for of, name in _KINDS if isinstance(value, of))
    if isinstance(value, str) and not value:
        return "an empty text"
    return next(names, "something else")
