"""Reads one large JSON object piece by piece: any length, flat memory."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

from filter_core.errors import JsonError, LayoutError
from filter_core.json_text import (
    LONG_NUMBER,
    JsonLimits,
    check_limits,
    find_long_number,
    read_json,
)

_PIECE: Final = 1 << 20

_MAX_VALUE: Final = 16 << 20
"""Bytes of one value; what is longer is no box and no image."""

_MANY_VALUES: Final = JsonLimits.max_values

_MAX_NAME: Final = 1 << 16

_SPACE: Final = " \t\n\r"


@dataclass(frozen=True)
class Item:
    """One element of a top-level list, or a whole top-level value.

    Attributes
    ----------
    key : str
    value : decoded JSON; its texts are Latin-1 until `text_of` decodes them
    start, end : int
        Its bytes in the file.
    is_empty : bool
        It stands for a list without elements.
    """

    key: str
    value: Any
    start: int
    end: int
    is_empty: bool = False


def read_object(file: BinaryIO, name: str) -> Iterator[Item]:
    """The values of one JSON object; those of lists one by one.

    Notes
    -----
    Bytes are read as Latin-1, so that a place in the text is a place in the file:
    JSON's own signs are ASCII, and nothing in a value is needed but ids and numbers.

    Raises
    ------
    LayoutError
        Not one JSON object; names the file and the byte.
    """
    yield from _Reader(file, name).items()


def load(content: bytes, name: str) -> Any:  # noqa: ANN401  # any JSON value
    """One value from its own bytes, as UTF-8."""
    try:
        return read_json(content)
    except JsonError as exc:
        raise LayoutError(f"{name}: {exc.detail}") from exc


def _no_constant(word: str) -> None:
    raise ValueError(f"{word} is no number of JSON")


class _Reader:
    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file, self._name = file, name
        self._text, self._at = "", 0
        self._before = 0
        self._decoder = json.JSONDecoder(parse_constant=_no_constant)
        self._ended = False

    def items(self) -> Iterator[Item]:
        if self._file.read(3) != b"\xef\xbb\xbf":
            self._file.seek(0)
        else:
            self._before = 3
        self._expect("{")
        if self._next() == "}":
            return
        while True:
            key = self._value(_MAX_NAME).value
            if not isinstance(key, str):
                raise self._error("a name in quotes")
            self._expect(":")
            yield from self._values(key)
            if self._next() == "}":
                return
            self._expect(",")

    def _values(self, key: str) -> Iterator[Item]:
        if self._next() != "[":
            yield self._value(_MAX_VALUE, key)
            return
        self._expect("[")
        if self._next() == "]":
            at = self._before + self._at
            self._expect("]")
            yield Item(key, None, at, at, is_empty=True)
            return
        while True:
            yield self._value(_MAX_VALUE, key)
            sign = self._next()
            self._expect("," if sign == "," else "]")
            if sign != ",":
                return

    def _next(self) -> str:
        """The next sign that is no space, which stays where it is."""
        while True:
            while self._at < len(self._text) and self._text[self._at] in _SPACE:
                self._at += 1
            if self._at < len(self._text):
                return self._text[self._at]
            if not self._more():
                raise self._error("more")

    def _expect(self, sign: str) -> None:
        if self._next() != sign:
            raise self._error(repr(sign))
        self._at += 1

    def _value(self, limit: int, key: str = "") -> Item:
        self._next()
        while True:
            try:
                value, end = self._decoder.raw_decode(self._text, self._at)
            except (ValueError, RecursionError) as exc:
                problem: Exception = exc
            else:
                # A number may go on beyond what has been read.
                if end < len(self._text) or self._ended:
                    self._check(self._text[self._at : end])
                    start, self._at = self._at, end
                    return Item(key, value, self._before + start, self._before + end)
                problem = ValueError("cut off")
            too_long = len(self._text) - self._at > limit
            if isinstance(problem, RecursionError) or too_long or not self._more():
                raise self._error("a JSON value", problem)

    def _more(self) -> bool:
        """Read on; twice as much each time, so that a long value costs no more."""
        wanted = max(_PIECE, len(self._text) - self._at)
        piece = self._file.read(wanted)
        self._before += self._at
        self._text = self._text[self._at :] + piece.decode("latin-1")
        self._at = 0
        self._ended = not piece
        self._refuse_long_numbers()
        return bool(piece)

    def _check(self, text: str) -> None:
        """What is short has too few values to be beyond a limit."""
        if len(text) < _MANY_VALUES:
            return
        try:
            check_limits(text.encode("latin-1"))
        except JsonError as exc:
            raise LayoutError(
                f"{self._name}, byte {self._before + self._at}: {exc.detail}"
            ) from exc

    def _refuse_long_numbers(self) -> None:
        """Before any is read; what has been read begins between two values."""
        start = find_long_number(self._text.encode("latin-1"))
        if start is not None:
            error = JsonError(LONG_NUMBER)
            place = f"{self._name}, byte {self._before + start}"
            raise LayoutError(f"{place}: {error.detail}")

    def _error(self, expected: str, cause: Exception | None = None) -> LayoutError:
        found = repr(self._text[self._at : self._at + 20]) if self._text else "the end"
        why = f" ({str(cause)[:60]})" if cause else ""
        return LayoutError(
            f"{self._name}, byte {self._before + self._at}: expected {expected}, found "
            f"{found}{why}"
        )
