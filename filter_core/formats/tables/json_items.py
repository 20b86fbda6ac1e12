"""A JSON file read value by value, each with its place in the file.

The file may have any length: it is read piece by piece, and only one element of a list
is in memory at a time.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, Final

from filter_core.errors import JsonError, LayoutError
from filter_core.json_text import (
    LONG_NUMBER,
    JsonLimits,
    check_limits,
    find_long_number,
    read_json,
)


@dataclass(frozen=True)
class JsonItem:
    """One element of a top-level list, or a whole top-level value.

    Attributes
    ----------
    value : decoded JSON
        Letters beyond ASCII in it are wrong, since bytes were read as Latin-1;
        `decode_value` decodes the value's bytes correctly.
    start, end : int
        Its bytes in the file.
    is_empty : bool
        It stands for a list without elements.
    in_list : bool
        It is an element of a top-level list.
    """

    key: str
    value: object
    start: int
    end: int
    is_empty: bool = False
    in_list: bool = False

    def read(self, file: BinaryIO) -> bytes:
        """Its bytes, of the file that it was read from."""
        file.seek(self.start)
        return file.read(self.end - self.start)


_PIECE: Final = 1 << 20
"""Bytes that are read at a time."""


def read_object(
    file: BinaryIO, name: str, *, piece_bytes: int = _PIECE
) -> Iterator[JsonItem]:
    """The values of one JSON object; those of lists one by one.

    `piece_bytes` are read at a time.

    Notes
    -----
    Bytes are read as Latin-1, so that a place in the text is a place in the file:
    JSON's syntax is ASCII, and of a value only ids and numbers are used.

    Raises
    ------
    LayoutError
        Not one JSON object; names the file and the byte.
    """
    yield from _Reader(file, name, piece_bytes).items()


def read_list(file: BinaryIO, name: str) -> Iterator[JsonItem]:
    """The values of one JSON list, one by one, as `read_object` reads them.

    Raises `LayoutError`: not one JSON list; names the file and the byte.
    """
    yield from _Reader(file, name, _PIECE).list_items()


_MAX_VALUE: Final = 16 << 20
"""Bytes of one value; boxes and images are shorter."""

_MANY_VALUES: Final = JsonLimits.max_values

_MAX_NAME: Final = 1 << 16
"""Bytes of one key."""

_SPACE: Final = " \t\n\r"


class _Reader:
    def __init__(self, file: BinaryIO, name: str, piece_bytes: int) -> None:
        self._file, self._name, self._piece_bytes = file, name, piece_bytes
        self._text, self._at = "", 0
        self._before = 0
        # NaN is no JSON, but spoils only the value that it is in: `decode_value`.
        self._decoder = json.JSONDecoder()
        self._ended = False

    def list_items(self) -> Iterator[JsonItem]:
        self._skip_mark()
        if self._next() != "[":
            raise self._error("'['")
        yield from (item for item in self._values("") if not item.is_empty)

    def _skip_mark(self) -> None:
        if self._file.read(3) != b"\xef\xbb\xbf":
            self._file.seek(0)
        else:
            self._before = 3

    def items(self) -> Iterator[JsonItem]:
        self._skip_mark()
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

    def _values(self, key: str) -> Iterator[JsonItem]:
        if self._next() != "[":
            yield self._value(_MAX_VALUE, key)
            return
        self._expect("[")
        if self._next() == "]":
            at = self._before + self._at
            self._expect("]")
            yield JsonItem(key, None, at, at, is_empty=True, in_list=True)
            return
        while True:
            yield self._value(_MAX_VALUE, key, in_list=True)
            sign = self._next()
            self._expect("," if sign == "," else "]")
            if sign != ",":
                return

    def _next(self) -> str:
        """The next character that is not white space; it is not consumed."""
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

    def _value(self, limit: int, key: str = "", *, in_list: bool = False) -> JsonItem:
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
                    place = self._before + start, self._before + end
                    return JsonItem(key, value, *place, in_list=in_list)
                problem = ValueError("cut off")
            # What was read of this value is checked before more of it is read, so that
            # a value beyond the limits is never parsed as a whole.
            self._check(self._text[self._at :])
            too_long = len(self._text) - self._at > limit
            if isinstance(problem, RecursionError) or too_long or not self._more():
                raise self._error("a JSON value", problem)

    def _more(self) -> bool:
        """Read a piece: as much again as is buffered, up to 1 MiB.

        So a value of 1 MiB is parsed a few times, not once for each of many small
        pieces. A longer one is parsed again after each MiB, since its parts are counted
        before more is read.
        """
        size = max(self._piece_bytes, min(len(self._text) - self._at, _PIECE))
        piece = self._file.read(size)
        self._before += self._at
        self._text = self._text[self._at :] + piece.decode("latin-1")
        self._at = 0
        self._ended = not piece
        # Refuse a long number before it is parsed; the text begins between values
        start = find_long_number(self._text.encode("latin-1"))
        if start is not None:
            error = JsonError(LONG_NUMBER)
            place = f"{self._name}, byte {self._before + start}"
            raise LayoutError(f"{place}: {error.detail}")
        return bool(piece)

    def _check(self, text: str) -> None:
        """Refuse a value beyond the limits; a short one has too few values for that."""
        if len(text) < _MANY_VALUES:
            return
        try:
            check_limits(text.encode("latin-1"))
        except JsonError as exc:
            raise LayoutError(
                f"{self._name}, byte {self._before + self._at}: {exc.detail}"
            ) from exc

    def _error(self, expected: str, cause: Exception | None = None) -> LayoutError:
        text = repr(self._text[self._at : self._at + 20]) if self._text else "the end"
        why = f" ({str(cause)[:60]})" if cause else ""
        return LayoutError(
            f"{self._name}, byte {self._before + self._at}: expected {expected}, found "
            f"{text}{why}"
        )


def decode_value(content: bytes, name: str) -> object:
    """One value from its own bytes, as UTF-8; `name` is their name in errors.

    Raises `LayoutError`: they are not JSON.
    """
    try:
        return read_json(content)
    except JsonError as exc:
        raise LayoutError(f"{name}: {exc.detail}") from exc
