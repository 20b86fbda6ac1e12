"""Values of carlasimu's files: of the right kind, or an error that names the key."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from filter_core.values import nearest
from unghost.capture.errors import ScenarioError


def mapping_of(value: object, at: str) -> Mapping[str, Any]:
    """Keys and values; none if nothing is given."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise _wrong(at, "keys and values", value)
    return {str(key): one for key, one in value.items()}


def list_of(value: object, at: str) -> list[Any]:
    """A list; an empty one if nothing is given."""
    if value is None:
        return []
    if not isinstance(value, list):
        raise _wrong(at, "a list", value)
    return value


def number_of(value: object, at: str) -> float:
    """A number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _wrong(at, "a number", value)
    return float(value)


def refuse_unknown(given: Mapping[str, Any], known: frozenset[str], at: str) -> None:
    """`ScenarioError` for the first key that carlasimu does not have."""
    for key in given:
        if key not in known:
            raise ScenarioError(
                f"{at}: {key}: unknown key; the nearest valid key is "
                f"{nearest(key, known)!r}"
            )


def _wrong(at: str, expected: str, value: object) -> ScenarioError:
    return ScenarioError(f"{at}: expected {expected}, found {repr(value)[:60]}")
