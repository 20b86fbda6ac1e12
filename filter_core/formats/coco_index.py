"""The byte positions of images and boxes in a COCO file, found in one pass.

The file may have any length: it is read piece by piece, and only a few numbers for each
image and box are kept in memory, with which it can be read again.
"""

from __future__ import annotations

import json
from array import array
from collections import Counter
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
from filter_core.values import shown


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
        The image of each annotation, -1 for one that the file does not have, -2 if the
        annotation names none; ascending.
    spans : (M, 2) int64
        First and last byte of each annotation, in the order of `owners`.
    positions : (M,) int64
        The place of each annotation in the file, in the order of `owners`.
    repeated : dict
        Rows of images that share an id, by the first of them.
    faulty : tuple of str
        What is wrong with each image, annotation and category that is not used.
    """

    name: str
    path: Path
    names: dict[CocoId, str]
    places: IntArray
    owners: IntArray
    spans: IntArray
    positions: IntArray
    repeated: dict[int, list[int]]
    faulty: tuple[str, ...] = ()

    def image(self, row: int) -> dict[str, object]:
        """The JSON object of one image."""
        with open_regular(self.path) as file:
            return self._load(file, self.places[row], f"images[{row}]")

    def boxes(self, row: int) -> Iterator[dict[str, object]]:
        """The annotations of one image, in the order of the file."""
        first, last = np.searchsorted(self.owners, [row, row + 1])
        with open_regular(self.path) as file:
            for number in range(int(first), int(last)):
                at = f"annotations[{self.positions[number]}]"
                yield self._load(file, self.spans[number], at)

    @property
    def orphans(self) -> list[int]:
        """Places of the annotations of images that the file does not have."""
        orphans: list[int] = self.positions[self.owners == _NO_IMAGE].tolist()
        return orphans

    def _load(self, file: BinaryIO, span: IntArray, at: str) -> dict[str, object]:
        start, end = map(int, span)
        file.seek(start)
        value = decode_value(file.read(end - start), f"{self.name}, {at}")
        if not isinstance(value, dict):
            raise LayoutError(f"{self.name}, {at}: expected an object")
        return value


_NO_IMAGE: Final = -1
"""The owner of annotations of images that the file does not have."""

_FAULTY: Final = -2
"""The owner of annotations that name no image."""

_MOST_FAULTS: Final = 10
"""Faulty elements of a list that are described; further ones are counted."""


class _NoIdError(LayoutError):
    """An element without an id that can be used."""


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
        self._counts: Counter[str] = Counter()
        self._faults: dict[str, list[str]] = {}

    def add(self, item: JsonItem) -> None:
        self._seen.add(item.key)
        if item.is_empty:
            return
        place = self._counts[item.key]
        self._counts[item.key] += 1
        try:
            if item.key == "images":
                self._add_image(item)
            elif item.key == "annotations":
                self._add_annotation(item)
            elif item.key == "categories":
                _id(item, "id")
                self._categories.append(item)
        except _NoIdError as exc:
            self._note_fault(item, place, exc.detail)

    def _note_fault(self, item: JsonItem, place: int, why: str) -> None:
        faults = self._faults.setdefault(item.key, [])
        number = item.value.get("id") if isinstance(item.value, dict) else None
        name = "" if number is None else f" (id {shown(number)})"
        faults.append(
            f"{item.key}[{place}]{name}: {why}" if len(faults) < _MOST_FAULTS else ""
        )

    def _add_image(self, item: JsonItem) -> None:
        number = _id(item, "id")
        row = len(self._places) // 2
        self._places.extend((item.start, item.end))
        first = self._rows.setdefault(number, row)
        if first != row:
            self._repeated.setdefault(first, [first]).append(row)

    def _add_annotation(self, item: JsonItem) -> None:
        self._spans.extend((item.start, item.end))
        self._owners.append(_FAULTY)
        # Ids become small numbers: annotations may come before the images.
        owner = _id(item, "image_id")
        self._owners[-1] = self._pending.setdefault(owner, len(self._pending))

    def index(self, path: Path) -> CocoIndex:
        if not {"images", "categories"} <= self._seen:
            raise LayoutError(
                f"{self._name}: expected images, annotations and categories, found "
                f"{', '.join(sorted(self._seen))[:100] or 'nothing'}"
            )
        rows = [self._rows.get(number, _NO_IMAGE) for number in self._pending]
        # The owner of faulty ones is a place from the end, where the same number is.
        row_of = np.array([*rows, _FAULTY, _FAULTY], np.int64)
        owners = row_of[np.array(self._owners, np.int64)]
        order = np.argsort(owners, kind="stable")
        spans = np.array(self._spans, np.int64).reshape(-1, 2)
        names = self._class_names(path)
        return CocoIndex(
            name=self._name,
            path=path,
            names=names,
            places=np.array(self._places, np.int64).reshape(-1, 2),
            owners=owners[order],
            spans=spans[order],
            positions=order,
            repeated=self._repeated,
            faulty=tuple(self._all_faults()),
        )

    def _all_faults(self) -> Iterator[str]:
        for key, faults in self._faults.items():
            yield from faults[:_MOST_FAULTS]
            if len(faults) > _MOST_FAULTS:
                yield f"{key}: {len(faults) - _MOST_FAULTS:,} more like this"

    def _class_names(self, path: Path) -> dict[CocoId, str]:
        names: dict[CocoId, str] = {}
        ambiguous: set[CocoId] = set()
        with open_regular(path) as file:
            for place, item in enumerate(self._categories):
                number = _id(item, "id")
                file.seek(item.start)
                # Nothing but the name is used, so nothing else can be wrong.
                category = json.loads(file.read(item.end - item.start))
                word = category.get("name")
                if not isinstance(word, str) or not word:
                    why = f"expected a name, found {shown(word)}"
                    self._note_fault(item, place, why)
                elif names.setdefault(number, word) != word:
                    ambiguous.add(number)
                    first = names[number]
                    why = (
                        f"this id is that of {shown(first)}, too, and of {shown(word)}"
                    )
                    self._note_fault(item, place, why)
        return {key: word for key, word in names.items() if key not in ambiguous}


def _id(item: JsonItem, key: str) -> CocoId:
    """The id under this key.

    Raises
    ------
    _NoIdError
        There is none.
    """
    value = item.value.get(key) if isinstance(item.value, dict) else None
    number = coco_id(value)
    if number is None:
        raise _NoIdError(
            f"expected an object with {key!r}, a number or text, found {shown(value)}"
        )
    return number


def coco_id(value: object) -> CocoId | None:
    """An id of a COCO file, or None if it is none; 1.0 is the same as 1."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        return None
    return value


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
        # NaN is no JSON, but spoils only the value that it is in: `decode_value`.
        self._decoder = json.JSONDecoder()
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
