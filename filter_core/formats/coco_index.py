"""The byte positions of images and boxes in a COCO file, found in one pass.

The file may have any length: it is read piece by piece, and only a few numbers for each
image and box are kept in memory, with which it can be read again.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final, TypeAlias

import numpy as np

from filter_core.errors import JsonError, LayoutError
from filter_core.formats.reading import open_regular
from filter_core.json_text import (
    LONG_NUMBER,
    JsonLimits,
    check_limits,
    find_long_number,
    read_json,
)
from filter_core.types import IntArray


def index_coco(path: Path, name: str) -> CocoIndex:
    """Read a file once, and store the position of each image and box.

    `name` is the name of the file in errors.

    Raises
    ------
    LayoutError
        Not JSON, or without images, annotations and categories.
    """
    builder = _Builder(name)
    with open_regular(path) as file:
        for item in read_object(file, name):
            builder.add(item)
    return builder.index(path)


CocoId: TypeAlias = int | str
"""The id of an image or category: a number in COCO, a text in files of some tools."""


@dataclass(frozen=True, eq=False)
class CocoIndex:
    """One COCO file, to be read image by image in any order of its boxes.

    Attributes
    ----------
    name : str
        Its name in errors.
    path : Path
    names : dict
        The class of each category id.
    places : (N, 2) int64
        First and last byte of each image.
    owners : (M,) int64
        The image of each annotation, -1 for none; ascending.
    spans : (M, 2) int64
        First and last byte of each annotation, in the order of `owners`.
    repeated : dict
        Rows of images that share an id, by the first of them.
    """

    name: str
    path: Path
    names: dict[CocoId, str]
    places: IntArray
    owners: IntArray
    spans: IntArray
    repeated: dict[int, list[int]]

    def image(self, row: int) -> dict[str, object]:
        """The JSON object of one image."""
        with open_regular(self.path) as file:
            return self._load(file, self.places[row], f"images[{row}]")

    def boxes(self, row: int) -> Iterator[dict[str, object]]:
        """The annotations of one image, in the order of the file."""
        first, last = np.searchsorted(self.owners, [row, row + 1])
        with open_regular(self.path) as file:
            for number in range(int(first), int(last)):
                start = int(self.spans[number, 0])
                yield self._load(
                    file, self.spans[number], f"the annotation at byte {start}"
                )

    @property
    def orphans(self) -> int:
        """Annotations of images that the file does not have."""
        return int((self.owners == -1).sum())

    def _load(self, file: BinaryIO, span: IntArray, at: str) -> dict[str, object]:
        start, end = map(int, span)
        file.seek(start)
        value = decode_value(file.read(end - start), f"{self.name}, {at}")
        if not isinstance(value, dict):
            raise LayoutError(f"{self.name}, {at}: expected an object")
        return value


class _Builder:
    def __init__(self, name: str) -> None:
        self._name = name
        self._rows: dict[CocoId, int] = {}
        self._repeated: dict[int, list[int]] = {}
        self._places = array("q")
        self._owners = array("q")
        self._spans = array("q")
        self._pending: dict[CocoId, int] = {}
        self._categories: list[JsonItem] = []
        self._seen: set[str] = set()

    def add(self, item: JsonItem) -> None:
        self._seen.add(item.key)
        if item.is_empty:
            return
        if item.key == "images":
            self._add_image(item)
        elif item.key == "annotations":
            self._add_annotation(item)
        elif item.key == "categories":
            self._categories.append(item)

    def _add_image(self, item: JsonItem) -> None:
        number = self._id(item, "id")
        row = len(self._places) // 2
        self._places.extend((item.start, item.end))
        first = self._rows.setdefault(number, row)
        if first != row:
            self._repeated.setdefault(first, [first]).append(row)

    def _add_annotation(self, item: JsonItem) -> None:
        # Ids become small numbers: annotations may come before the images.
        owner = self._id(item, "image_id")
        self._owners.append(self._pending.setdefault(owner, len(self._pending)))
        self._spans.extend((item.start, item.end))

    def _id(self, item: JsonItem, key: str) -> CocoId:
        value = item.value.get(key) if isinstance(item.value, dict) else None
        if isinstance(value, bool) or not isinstance(value, (int, str)):
            raise LayoutError(
                f"{self._name}, byte {item.start}: expected an object with {key!r}, a "
                f"number or text, found {str(value)[:40]!r}"
            )
        return value

    def index(self, path: Path) -> CocoIndex:
        if not {"images", "categories"} <= self._seen:
            raise LayoutError(
                f"{self._name}: expected images, annotations and categories, found "
                f"{', '.join(sorted(self._seen))[:100] or 'nothing'}"
            )
        row_of = np.array([self._rows.get(i, -1) for i in self._pending], np.int64)
        owners = row_of[np.array(self._owners, np.int64)] if len(row_of) else row_of
        order = np.argsort(owners, kind="stable")
        spans = np.array(self._spans, np.int64).reshape(-1, 2)
        return CocoIndex(
            name=self._name,
            path=path,
            names=self._class_names(path),
            places=np.array(self._places, np.int64).reshape(-1, 2),
            owners=owners[order],
            spans=spans[order],
            repeated=self._repeated,
        )

    def _class_names(self, path: Path) -> dict[CocoId, str]:
        names: dict[CocoId, str] = {}
        with open_regular(path) as file:
            for item in self._categories:
                number = self._id(item, "id")
                file.seek(item.start)
                category = decode_value(file.read(item.end - item.start), self._name)
                word = category.get("name") if isinstance(category, dict) else None
                if not isinstance(word, str) or not word:
                    raise LayoutError(
                        f"{self._name}: category {number!r}: expected a name, found "
                        f"{str(word)[:40]!r}"
                    )
                if number in names:
                    raise LayoutError(
                        f"{self._name}: expected each category id once, found "
                        f"{number!r} for {names[number]!r} and {word[:40]!r}"
                    )
                names[number] = word
        return names


_LISTS: Final = ("images", "annotations", "categories")


def looks_like_coco(path: Path) -> bool:
    """Whether a file is one object with the lists that COCO has; never raises."""
    seen = set()
    try:
        with open_regular(path) as file:
            for item in read_object(file, path.name):
                seen.add(item.key)
                if seen.issuperset(_LISTS):
                    return True
    except (LayoutError, OSError):
        return False
    return False


@dataclass(frozen=True)
class JsonItem:
    """One element of a top-level list, or a whole top-level value.

    Attributes
    ----------
    key : str
    value : decoded JSON
        Letters beyond ASCII in it are wrong, since bytes were read as Latin-1;
        `decode_value` decodes the value's bytes correctly.
    start, end : int
        Its bytes in the file.
    is_empty : bool
        It stands for a list without elements.
    """

    key: str
    value: object
    start: int
    end: int
    is_empty: bool = False


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
        self._decoder = json.JSONDecoder(parse_constant=_no_constant)
        self._ended = False

    def items(self) -> Iterator[JsonItem]:
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

    def _values(self, key: str) -> Iterator[JsonItem]:
        if self._next() != "[":
            yield self._value(_MAX_VALUE, key)
            return
        self._expect("[")
        if self._next() == "]":
            at = self._before + self._at
            self._expect("]")
            yield JsonItem(key, None, at, at, is_empty=True)
            return
        while True:
            yield self._value(_MAX_VALUE, key)
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

    def _value(self, limit: int, key: str = "") -> JsonItem:
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
                    return JsonItem(
                        key, value, self._before + start, self._before + end
                    )
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
        wanted = max(self._piece_bytes, min(len(self._text) - self._at, _PIECE))
        piece = self._file.read(wanted)
        self._before += self._at
        self._text = self._text[self._at :] + piece.decode("latin-1")
        self._at = 0
        self._ended = not piece
        self._refuse_long_numbers()
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

    def _refuse_long_numbers(self) -> None:
        """Refuse a long number before it is parsed; the text begins between values."""
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


def _no_constant(word: str) -> None:
    raise ValueError(f"{word} is not a JSON number")


def decode_value(content: bytes, name: str) -> object:
    """One value from its own bytes, as UTF-8; `name` is their name in errors.

    Raises
    ------
    LayoutError
        They are not JSON.
    """
    try:
        return read_json(content)
    except JsonError as exc:
        raise LayoutError(f"{name}: {exc.detail}") from exc
