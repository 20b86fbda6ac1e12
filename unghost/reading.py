"""JSON objects into frozen dataclasses, tolerant of what a newer server adds.

Types are not validated: the server is the authority, a test proves that both agree.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from datetime import datetime
from typing import Any, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

ResultT = TypeVar("ResultT", bound="Result")

Convert: TypeAlias = Callable[[Any], Any]
# Of each field: its name, its key, whether the key must be there, how to read it.
Plan: TypeAlias = tuple[tuple[str, str, bool, Convert], ...]


class MissingKey(ValueError):
    """A JSON object lacks a key that the client cannot do without."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """What a call returns; `raw` is the JSON object as it came, unknown keys included.

    A field whose key in JSON is a keyword of Python names it in `metadata["key"]`.
    """

    raw: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def read(cls: type[ResultT], raw: Mapping[str, Any]) -> ResultT:
        """Build from a JSON object; null is the same as absent."""
        known: dict[str, Any] = {"raw": raw}
        for name, key, required, convert in _plan_of(cls):
            value = raw.get(key)
            if value is not None:
                known[name] = convert(value)
            elif required:
                raise MissingKey(f"{cls.__name__} lacks {key!r}")
        return cls(**known)


_PLANS: dict[type[Result], Plan] = {}


def _plan_of(cls: type[Result]) -> Plan:
    # Resolving type hints costs more than reading an object: once per class.
    if cls not in _PLANS:
        _PLANS[cls] = _plan(cls)
    return _PLANS[cls]


def _plan(cls: type[Result]) -> Plan:
    hints = get_type_hints(cls)
    return tuple(
        (
            each.name,
            each.metadata.get("key", each.name),
            each.default is MISSING and each.default_factory is MISSING,
            _converter(hints[each.name]),
        )
        for each in fields(cls)
        if each.name != "raw"
    )


def _converter(hint: object) -> Convert:
    origin = get_origin(hint)
    if origin in (Union, types.UnionType):
        inner = [arg for arg in get_args(hint) if arg is not type(None)]
        return _converter(inner[0]) if len(inner) == 1 else _as_it_is
    if origin is tuple:
        item = _converter(get_args(hint)[0])
        return lambda values: tuple(item(value) for value in values)
    if origin is Mapping:
        item = _converter(get_args(hint)[1])
        return lambda values: {key: item(value) for key, value in values.items()}
    if isinstance(hint, type) and issubclass(hint, Result):
        return hint.read
    if hint is datetime:
        return _time
    return _as_it_is


def _as_it_is(value: object) -> object:
    return value


def _time(text: str) -> datetime:
    # Python 3.10's fromisoformat does not read the Z of RFC 3339.
    return datetime.fromisoformat(text.replace("Z", "+00:00"))
