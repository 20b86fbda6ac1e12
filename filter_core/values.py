"""Reads values from untrusted JSON; invalid values are collected as faults.

Code that reads an annotation passes a `Place` and the `Faults` along. The functions
`read_...` take one value of the parsed JSON and return it checked and converted. If it
is invalid, they add a fault and return None or a default, so that one pass finds all
faults. A fault has a stable code, the JSON pointer of the value, and a sentence with
the expected and the found value. Nothing is raised before `Faults.raise_any`.

Other functions quote untrusted text (`shown`, `pointer_token`, `escape_text`) or
suggest the most similar valid word (`nearest`, `similar`); configurations and requests
use them, too.
"""

from __future__ import annotations

import difflib
import math
import unicodedata
from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Any, Final, TypeAlias

import numpy as np

from filter_core.errors import AnnotationError, AnnotationErrors, FilterError

JsonObject: TypeAlias = Mapping[str, Any]
"""An untrusted JSON object; the types of its values are not known."""


class Place:
    """The place of a value in the JSON, as a JSON pointer and in words for people.

    ``Place() / "boxes" / 3`` points to ``/boxes/3``. The words are composed only for a
    fault, because most places never need them.
    """

    __slots__ = ("_key", "_parent")

    def __init__(self, key: str | int = "", parent: Place | None = None) -> None:
        self._key = key
        self._parent = parent

    def __truediv__(self, key: str | int) -> Place:
        return Place(key, self)

    @property
    def label(self) -> str:
        """A name of this place; places below it are then named relative to it."""
        return ""

    @property
    def is_boxes(self) -> bool:
        """Whether it is the annotation's list of boxes."""
        root = self._parent
        return self._key == "boxes" and root is not None and root._parent is None

    @property
    def pointer(self) -> str:
        """The JSON pointer (RFC 6901); of a long key it has the beginning and "…"."""
        if self._parent is None:
            return ""
        return f"{self._parent.pointer}/{pointer_token(self._key)}"

    @property
    def words(self) -> str:
        """The place for people, such as ``box 3 (id "217"), xyxy[2]``."""
        label, field = self._label_and_field()
        return ", ".join(part for part in (label, field) if part)

    def _label_and_field(self) -> tuple[str, str]:
        if self.label or self._parent is None:
            return self.label, ""
        label, field = self._parent._label_and_field()
        if isinstance(self._key, int):
            return label, f"{field}[{self._key}]"
        key = _shown_key(self._key)
        return label, f"{field}.{key}" if field else key


class BoxPlace(Place):
    """The place of a box, which is named by its index and its id."""

    __slots__ = ("_id",)

    def __init__(self, index: int, box_id: object) -> None:
        super().__init__(index, _BOXES)
        self._id = str(index) if box_id is None else box_id

    @property
    def label(self) -> str:
        """Such as ``box 3 (id "217")``."""
        return f"box {self._key} (id {shown(self._id)})"


_BOXES: Final = Place("boxes", Place())

MAX_FAULTS: Final = 100
"""Faults of one annotation that are kept; further ones are only counted."""


class Faults:
    """The faults found so far; nothing is raised until `raise_any`.

    The first `MAX_FAULTS` are kept, the others only counted, since the sender of an
    annotation decides how many there are.
    """

    def __init__(self, frame: str = "") -> None:
        self._frame = frame
        self._errors: list[AnnotationError] = []
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, at: Place, code: str, expected: str, found: str) -> None:
        """Note one fault: its place, a stable code, what was expected and found."""
        self._count += 1
        if self._count > MAX_FAULTS:
            return
        frame = f"frame {self._frame}" if self._frame else ""
        subject = ", ".join(part for part in (frame, at.words) if part)
        detail = f"{subject or 'annotation'}: expected {expected}, found {found}"
        self._errors.append(AnnotationError(detail, pointer=at.pointer, code=code))

    def take(self, error: FilterError) -> None:
        """Note a fault that a constructor has raised."""
        self._count += 1
        if self._count > MAX_FAULTS:
            return
        frame = f"frame {self._frame}, " if self._frame else ""
        self._errors.append(
            AnnotationError(
                f"{frame}{error.detail}", pointer=error.pointer, code=error.kind
            )
        )

    def as_error(self) -> AnnotationErrors:
        """The faults as one error, in the order in which they were noted."""
        return AnnotationErrors(self._errors, self._count)

    def raise_any(self) -> None:
        """Raise `as_error` if there are any faults."""
        if self._errors:
            raise self.as_error()


_MAX_MAGNITUDE: Final = 1e9
"""A larger number is not a coordinate: in metres it lies beyond any map."""

_NUMBER: Final = (int, float, np.integer, np.floating)


def read_number(value: object, at: Place, faults: Faults) -> float | None:
    """A finite number between -1e9 and 1e9, or None and a fault.

    Text and booleans are not numbers, however they look.
    """
    if isinstance(value, bool) or not isinstance(value, _NUMBER):
        faults.add(at, "not_a_number", "a number", shown(value))
    elif not isinstance(value, int) and not math.isfinite(value):
        faults.add(at, "not_finite", "a finite number", shown(value))
    elif abs(value) > _MAX_MAGNITUDE:
        expected = "a number between -1e9 and 1e9"
        faults.add(at, "number_too_large", expected, shown(value))
    else:
        return float(value)
    return None


def read_numbers(
    value: object, count: int, at: Place, faults: Faults
) -> tuple[float, ...] | None:
    """A list of exactly `count` numbers, or None and every fault in it."""
    if type(value) is list and len(value) == count:
        plain = plain_numbers(value)
        if plain is not None:
            return plain
    items = read_list(value, count, at, faults, of="numbers")
    if items is None:
        return None
    read = [read_number(item, at / i, faults) for i, item in enumerate(items)]
    numbers = tuple(number for number in read if number is not None)
    return numbers if len(numbers) == count else None


def plain_numbers(items: Iterable[object]) -> tuple[float, ...] | None:
    """Items that are all valid ints and floats; None if any must be checked.

    A fast path for the usual case: if it is None, readers check item by item.
    """
    numbers: list[float] = []
    for item in items:
        if type(item) is not float and type(item) is not int:
            return None
        if not -_MAX_MAGNITUDE <= item <= _MAX_MAGNITUDE:
            return None
        numbers.append(float(item))
    return tuple(numbers)


def read_list(
    value: object, count: int, at: Place, faults: Faults, *, of: str
) -> list[object] | None:
    """A list, tuple or array of exactly `count` items, or None and a fault."""
    items = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(items, (list, tuple)):
        faults.add(at, "not_a_list", f"a list of {count} {of}", shown(items))
    elif len(items) != count:
        expected = f"a list of {count} {of}"
        faults.add(at, "wrong_length", expected, shown(items))
    else:
        return list(items)
    return None


def read_text(value: object, at: Place, faults: Faults, limit: int) -> str | None:
    """A text of at most `limit` characters without control characters, or None.

    Null is None without a fault.
    """
    if value is None:
        return None
    if not isinstance(value, str):
        faults.add(at, "not_a_text", "a text", shown(value))
    elif not value.strip():
        faults.add(at, "empty", "a text that is not empty", shown(value))
    elif len(value) > limit:
        expected = f"at most {limit} characters"
        faults.add(at, "text_too_long", expected, f"{len(value)} characters")
    elif not _is_storable(value):
        expected = "a text without control characters"
        faults.add(at, "control_character", expected, shown(value))
    else:
        return value
    return None


def as_text(value: object) -> str | None:
    """A text, or None of anything else, as annotations have it that are not checked."""
    return value if isinstance(value, str) else None


def _is_storable(text: str) -> bool:
    """No control characters and no halves of surrogate pairs."""
    return text.isprintable() or not any(
        unicodedata.category(character) in ("Cc", "Cs") for character in text
    )


_MAX_INTEGER: Final = 2**63 - 1
"""Numbers of instances beyond it fit no database column."""

_MAX_ID: Final = 2**64 - 1
"""CARLA's environment objects have ids of 64 bits without a sign."""


def read_id(value: object, index: int, at: Place, faults: Faults, limit: int) -> str:
    """The box's id as text; the index where none is given or it cannot be used."""
    if value is None:
        return str(index)
    if isinstance(value, int) and not isinstance(value, bool):
        if -_MAX_INTEGER <= value <= _MAX_ID:
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
    if not 0 <= value <= _MAX_INTEGER:
        faults.add(at, "out_of_range", "an integer from 0 to 2^63 - 1", shown(value))
        return None
    return value


def read_time(value: object, at: Place, faults: Faults, limit: int) -> str | None:
    """An RFC 3339 time as given, or None; null is None without a fault."""
    text = read_text(value, at, faults, limit)
    if text is None:
        return None
    # Python 3.10 reads neither "Z" nor fractions other than 3 or 6 digits.
    utc = text[:-1] + "+00:00" if text[-1:] in "Zz" else text
    head, dot, tail = utc.partition(".")
    digits = len(tail) - len(tail.lstrip("0123456789"))
    if dot and digits:
        utc = f"{head}.{tail[:digits][:6]:0<6}{tail[digits:]}"
    try:
        moment = datetime.fromisoformat(utc)
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None:
        expected = "an RFC 3339 time such as 2026-01-01T00:00:00Z"
        faults.add(at, "bad_time", expected, shown(text))
        return None
    return text


_MAX_DEPTH: Final = 32
"""Deeper JSON can exhaust the stack of programs that read it."""


def check_kept_object(value: object, at: Place, faults: Faults) -> None:
    """Adds faults of an object that is stored as it is; null is the same as none."""
    if isinstance(value, Mapping):
        check_kept(value, at, faults)
    elif value is not None:
        faults.add(at, "not_an_object", "an object", shown(value))


def check_kept(value: object, at: Place, faults: Faults, depth: int = 0) -> None:
    """Adds faults of a value that is stored as it is and must be valid JSON."""
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
    """A fast path for usual values, of which there may be hundreds of thousands."""
    if isinstance(value, float):
        return math.isfinite(value)
    return value is None or isinstance(value, int)


def _check_key(key: object, at: Place, faults: Faults) -> None:
    if not isinstance(key, str) or not _is_storable(key):
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
    # Line breaks are allowed; database columns accept neither NUL nor half a pair.
    if text.isascii():
        return "\0" not in text
    try:
        return b"\0" not in text.encode()
    except UnicodeEncodeError:
        return False


_SHOWN_TEXT: Final = 60


def shown(value: object) -> str:
    """A value as shown in error messages: short and on one line."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        cut = value if len(value) <= _SHOWN_TEXT else value[:_SHOWN_TEXT] + "…"
        # repr-like escapes keep control characters out of logs and terminals.
        return "the text " + ascii(cut) if not cut.isprintable() else f'"{cut}"'
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    return _shown_number(value) if isinstance(value, _NUMBER) else type(value).__name__


def _shown_number(value: object) -> str:
    if isinstance(value, int) and value.bit_length() > 256:
        return f"an integer of {value.bit_length()} bits"
    if isinstance(value, (float, np.floating)) and not math.isfinite(value):
        return (
            "NaN" if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")
        )
    return str(value)


def prefix_of(at: str) -> str:
    """A JSON pointer as the beginning of a message."""
    return f"{at.strip('/').replace('/', '.')}: " if at else ""


def pointer_token(key: object) -> str:
    """A key of the input as one token of a JSON pointer (RFC 6901), shortened."""
    return _shown_key(str(key)).replace("~", "~0").replace("/", "~1")


_SHOWN_KEY: Final = 80


def _shown_key(key: str) -> str:
    return escape_text(key if len(key) <= _SHOWN_KEY else key[:_SHOWN_KEY] + "…")


def escape_text(text: str) -> str:
    """The text as UTF-8 can encode it: halves of surrogate pairs as ``\\ud800``."""
    return text.encode("utf-8", "backslashreplace").decode()


_SIMILAR: Final = 0.6
"""The similarity from which a word counts as misspelt."""


def nearest(word: object, vocabulary: Iterable[str]) -> str:
    """The known word that is most similar to this one."""
    return _matches(word, vocabulary, 0.0)[0]


def similar(
    word: object, vocabulary: Iterable[str], *, likeness: float = _SIMILAR
) -> str | None:
    """The known word that was probably meant; None if no word is similar enough.

    `likeness` is 1 for equal words. Demand more where other words may be on purpose.
    """
    return next(iter(_matches(word, vocabulary, likeness)), None)


def _matches(word: object, vocabulary: Iterable[str], cutoff: float) -> list[str]:
    # difflib is quadratic: a kilobyte of nonsense must not cost a second.
    return difflib.get_close_matches(str(word)[:80], sorted(vocabulary), 1, cutoff)
