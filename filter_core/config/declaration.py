"""What the declaration of a key consists of: allowed values, default, meaning.

`key` makes the dataclass field that declares a key, and `declared_keys` finds the keys
of a class. Its allowed values are `PERCENT`, `METRES`, `NEAREST_METRES`,
`FARTHEST_METRES`, `counted`, `AllowedWords`, `TagList` or one of the other classes
here. The keys themselves are in `keys.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import field, fields
from enum import Enum
from typing import Any, Final, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import Dataclass
from filter_core.class_names import class_meant_by
from filter_core.classes import (
    MAX_ACCEPT,
    MAX_CHANGED_TAGS,
    MEASURED_CLASSES,
    PASS,
    canonical_accept,
    canonical_tags,
)
from filter_core.errors import ConfigError
from filter_core.evidence_kinds import AUTO, STRONGEST_FIRST
from filter_core.segmentation.palettes import LAST_TAG
from filter_core.values import pointer_token, prefix_of, shown, similar

Number: TypeAlias = float | int


class Inherit(Enum):
    """The value of a key that is not given; None would mean no limit.

    In the overrides of a class it stands for the configuration's value. A configuration
    replaces it by the default of the key.
    """

    GLOBAL = "global"


INHERIT: Final = Inherit.GLOBAL


class Allowed(Protocol):
    """The allowed values of a key. ``str()`` describes them for people."""

    def checked(self, name: str, value: object, at: str = "") -> object:
        """The value in its one canonical form.

        Parameters
        ----------
        name : str
            The key.
        value : object
            As a file or a request has it.
        at : str
            JSON pointer of the mapping that the key is in.

        Raises
        ------
        ConfigError
            The value is not allowed; the message names key, value and what is allowed.
        """

    def schema(self) -> dict[str, object]:
        """The same as JSON schema."""


class NumberRange(NamedTuple):
    """Numbers from `low` to `high`, both included; perhaps null as well.

    Attributes
    ----------
    low, high : float or int
    unit : str
        In the plural, such as ``metres``.
    whole : bool
        Whether fractions are refused.
    null : float or None
        Null (no limit) is allowed if this is a number: the one that stands for it in
        arrays, such as ``inf``. None: null is refused.
    """

    low: Number
    high: Number
    unit: str
    whole: bool = False
    null: float | None = None

    def __str__(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        null = "" if self.null is None else " or null"
        return f"{kind} from {self.low} to {self.high} {self.unit}{null}"

    def checked(self, name: str, value: object, at: str = "") -> Number | None:
        """See `Allowed.checked`.

        Whole numbers become ``int`` and others ``float``, so that 10 and 10.0 are the
        same configuration with the same digest.
        """
        if value is None and self.null is not None:
            return None
        # YAML's yes and no are booleans, which Python would take for 1 and 0.
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise wrong_value(name, value, str(self), at)
        inside = self.low <= value <= self.high  # False for NaN
        if not inside or (self.whole and value != int(value)):
            raise wrong_value(name, value, str(self), at)
        return int(value) if value == int(value) else value

    def schema(self) -> dict[str, object]:
        kind = "integer" if self.whole else "number"
        return {
            "type": kind if self.null is None else [kind, "null"],
            "minimum": self.low,
            "maximum": self.high,
            "x-unit": self.unit,
        }

    def array(self, values: Iterable[Number | None]) -> NDArray[np.float64 | np.int64]:
        """Such numbers as a read-only array, in which `null` stands for None."""
        array: NDArray[np.float64 | np.int64] = np.array(
            [self.null if value is None else value for value in values],
            np.int64 if self.whole else np.float64,
        )
        array.setflags(write=False)
        return array


_MAX_METRES: Final = 1_000_000

# The largest signed 32-bit integer, so that every count can be stored anywhere.
_MAX_COUNT: Final = 2**31 - 1

PERCENT: Final = NumberRange(0, 100, "percent")

METRES: Final = NumberRange(0, _MAX_METRES, "metres")

NEAREST_METRES: Final = METRES._replace(null=-math.inf)
"""The nearest distance that is allowed; null: no limit."""

FARTHEST_METRES: Final = METRES._replace(null=math.inf)
"""The farthest distance that is allowed; null: no limit."""


MAX_CLASS_NAME: Final = 200
"""Characters of a class's name in a configuration."""


def counted(unit: str) -> NumberRange:
    """Whole numbers of something, such as ``pixels``."""
    return NumberRange(0, _MAX_COUNT, unit, whole=True)


class AllowedWords(NamedTuple):
    """One of a few words."""

    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"one of {', '.join(self.words)}"

    def checked(self, name: str, value: object, at: str = "") -> str:
        """See `Allowed.checked`; the message suggests the nearest word."""
        if not isinstance(value, str) or value not in self.words:
            close = similar(value, self.words)
            hint = f"; did you mean {close!r}?" if close else ""
            raise wrong_value(name, value, str(self), at, hint)
        return value

    def schema(self) -> dict[str, object]:
        return {"type": "string", "enum": list(self.words)}


class TagList:
    """Lists of tags, by name or number."""

    def __str__(self) -> str:
        return f"a list of 1 to {MAX_ACCEPT} tag names or numbers"

    def checked(self, name: str, value: object, at: str = "") -> tuple[str | int, ...]:
        return canonical_accept(value, at=f"{at}/{name}")

    def schema(self) -> dict[str, object]:
        number = {"type": "integer", "minimum": 0, "maximum": LAST_TAG}
        return {
            "type": "array",
            "items": {"anyOf": [{"type": "string"}, number]},
            "minItems": 1,
            "maxItems": MAX_ACCEPT,
        }


class ChangedTagNames:
    """Names of tags by numbers and colours of a changed CARLA."""

    def __str__(self) -> str:
        return "names of tags by number (0 to 255) or colour"

    def checked(self, name: str, value: object, at: str = "") -> dict[str, str]:
        return canonical_tags(value, at=f"{at}/{name}")

    def schema(self) -> dict[str, object]:
        return {
            "type": "object",
            "additionalProperties": {"type": "string"},
            "maxProperties": MAX_CHANGED_TAGS,
        }


class AllowedScale:
    """A whole number from 1, or ``auto``."""

    def __str__(self) -> str:
        return f"auto or {_SCALE}"

    def checked(self, name: str, value: object, at: str = "") -> int | str:
        if value == "auto":
            return "auto"
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise wrong_value(name, value, str(self), at)
        return int(_SCALE.checked(name, value, at) or 0)

    def schema(self) -> dict[str, object]:
        number = {"type": "integer", "minimum": _SCALE.low, "maximum": _SCALE.high}
        return {"anyOf": [{"const": "auto"}, number]}


_SCALE: Final = NumberRange(1, 255, "grey levels", whole=True)


class ClassName:
    """Names of classes that can be measured, or ``pass``.

    Whether the configuration knows a name is checked when all its classes are there.
    """

    def __str__(self) -> str:
        return f"the name of a class, or {PASS}"

    def checked(self, name: str, value: object, at: str = "") -> str:
        """See `Allowed.checked`; a name that means a class becomes that class."""
        if not isinstance(value, str) or not 0 < len(value) <= MAX_CLASS_NAME:
            raise wrong_value(name, value, str(self), at)
        return class_meant_by(value) or value

    def schema(self) -> dict[str, object]:
        """See `Allowed.schema`; the examples are the classes that need no others."""
        return {
            "type": "string",
            "minLength": 1,
            "maxLength": MAX_CLASS_NAME,
            "examples": [*MEASURED_CLASSES, PASS],
        }


class Key(NamedTuple):
    """The declaration of one key of a configuration.

    Attributes
    ----------
    sentence : str
        What it means, for people.
    evidence : tuple of str
        The kinds of evidence whose rules use the key; empty: all.
    needs_pixels : bool
        Whether images may have to be read again after it has changed.
    place : str
        The key in a file, such as ``depth.encoding``; empty: the name of the field.
    """

    allowed: Allowed
    default: object
    sentence: str
    evidence: tuple[str, ...] = ()
    needs_pixels: bool = False
    place: str = ""

    def schema(self) -> dict[str, object]:
        """Its JSON schema, without the default."""
        schema = {**self.allowed.schema(), "description": self.sentence}
        if self.evidence:
            tried = any(name in STRONGEST_FIRST for name in self.evidence)
            schema["x-evidence"] = [*self.evidence, *([AUTO] if tried else [])]
        return schema | {"x-needs-pixels": self.needs_pixels}


_KEY: Final = "key"

_Field: TypeAlias = Any
"""`dataclasses.field`, typed so that it fits every annotation."""


def key(
    allowed: Allowed,
    default: object,
    sentence: str,
    *,
    evidence: tuple[str, ...] = (),
    needs_pixels: bool = False,
) -> _Field:
    """A dataclass field that declares a key; for the parameters see `Key`.

    Where no value is given, the field is `INHERIT` until the configuration puts
    `default` in its place. (In the overrides of a class it stays `INHERIT`.)
    """
    declared = Key(allowed, default, sentence, evidence, needs_pixels)
    return field(default=INHERIT, metadata={_KEY: declared})


def placed(place: str, allowed: Allowed, default: object, sentence: str) -> _Field:
    """A dataclass field that declares a key at another place than its name."""
    return moved(place, Key(allowed, default, sentence))


def moved(place: str, declared: Key) -> _Field:
    """A dataclass field that declares a key of another class (`declared_keys`)."""
    return field(default=INHERIT, metadata={_KEY: declared._replace(place=place)})


def declared_keys(of: type[Dataclass]) -> dict[str, Key]:
    """The keys that a class and its bases declare, in the order of its fields."""
    return {
        spec.name: spec.metadata[_KEY] for spec in fields(of) if _KEY in spec.metadata
    }


def refuse_unknown_keys(
    names: Iterable[object], valid: Iterable[str], *, at: str = ""
) -> None:
    """Raise `ConfigError` for the first name that is not valid."""
    valid_names = tuple(valid)
    for name in names:
        if name not in valid_names:
            close = similar(name, valid_names)
            hint = (
                f"the nearest valid key is {close!r}"
                if close
                else f"expected one of {', '.join(valid_names)}"
            )
            text = repr(name)
            quoted = text if len(text) <= 60 else f"{text[:57]}..."
            raise ConfigError(
                f"{prefix_of(at)}unknown key {quoted}; {hint}",
                pointer=f"{at}/{pointer_token(name)}",
                code="unknown_key",
            )


def wrong_value(
    name: str, value: object, expected: object, at: str, hint: str = ""
) -> ConfigError:
    """The error about the value of a key, whose parent is at the pointer `at`."""
    return ConfigError(
        f"{prefix_of(at)}{name}: expected {expected}, found {shown(value)}{hint}",
        pointer=f"{at}/{name}",
    )
