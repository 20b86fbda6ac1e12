"""The byte positions of images and boxes in a COCO file, found in one pass.

The file may have any length: it is read piece by piece, and only a few numbers for each
image and box are kept in memory, with which it can be read again.
"""

from __future__ import annotations

import json
from array import array
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO, Final, TypeAlias

import numpy as np

from filter_core.arrays import IntArray
from filter_core.errors import LayoutError
from filter_core.formats.reading import open_regular
from filter_core.formats.tables.json_items import JsonItem, decode_value, read_object
from filter_core.values import shown


def index_coco(path: Path, name: str) -> CocoIndex:
    """Read a file once, and store the position of each image and box.

    `name` is the name of the file in errors. Raises `LayoutError`: not JSON, or without
    images, annotations and categories.
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
    names : dict
        The class of each category id.
    ids : tuple
        The id of each image.
    categories : dict
        Each category as the file has it, by its name; of several the first.
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
    beside : dict
        The other values of the file, such as ``info`` and ``licenses``; empty if they
        are large.
    faulty : tuple of str
        What is wrong with each image, annotation and category that is not used.
    """

    name: str
    path: Path
    names: dict[CocoId, str]
    ids: tuple[CocoId, ...]
    categories: dict[str, dict[str, object]]
    places: IntArray
    owners: IntArray
    spans: IntArray
    positions: IntArray
    repeated: dict[int, list[int]]
    beside: dict[str, object] = field(default_factory=dict)
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

    def places_of_boxes(self, row: int) -> tuple[int, ...]:
        """The places of the annotations of one image in the file's list."""
        first, last = np.searchsorted(self.owners, [row, row + 1])
        return tuple(self.positions[first:last].tolist())

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


LISTS: Final = ("images", "annotations", "categories")
"""The keys of the lists that every COCO file has."""

_MOST_BESIDE: Final = 1 << 20
"""Bytes of values besides images, annotations and categories that are kept."""

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
        self._ids: list[CocoId] = []
        self._places = array("q")
        self._owners = array("q")
        self._spans = array("q")
        self._pending: dict[CocoId, int] = {}
        self._categories: list[JsonItem] = []
        self._beside: list[JsonItem] = []
        self._beside_bytes = 0
        self._seen: set[str] = set()
        self._counts: Counter[str] = Counter()
        self._faults: dict[str, list[str]] = {}

    def add(self, item: JsonItem) -> None:
        self._seen.add(item.key)
        if item.is_empty:
            if item.key not in LISTS:
                self._beside.append(item)
            return
        place = self._counts[item.key]
        self._counts[item.key] += 1
        try:
            if item.key == "images":
                self._add_image(item)
            elif item.key == "annotations":
                self._spans.extend((item.start, item.end))
                self._owners.append(_FAULTY)
                # Ids become small numbers: annotations may come before the images.
                owner = _id(item, "image_id")
                self._owners[-1] = self._pending.setdefault(owner, len(self._pending))
            elif item.key == "categories":
                _id(item, "id")
                self._categories.append(item)
            else:
                self._beside_bytes += item.end - item.start
                if self._beside_bytes <= _MOST_BESIDE:
                    self._beside.append(replace(item, value=None))
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
        self._ids.append(number)
        self._places.extend((item.start, item.end))
        first = self._rows.setdefault(number, row)
        if first != row:
            self._repeated.setdefault(first, [first]).append(row)

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
        names: dict[CocoId, str] = {}
        categories: dict[str, dict[str, object]] = {}
        ambiguous: set[CocoId] = set()
        with open_regular(path) as file:
            for place, item in enumerate(self._categories):
                number = _id(item, "id")
                # Nothing but the name is used, so nothing else can be wrong.
                category = json.loads(item.read(file).decode("utf-8", "replace"))
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
                else:
                    categories.setdefault(word, category)
        return CocoIndex(
            name=self._name,
            path=path,
            names={key: name for key, name in names.items() if key not in ambiguous},
            ids=tuple(self._ids),
            categories=categories,
            places=np.array(self._places, np.int64).reshape(-1, 2),
            owners=owners[order],
            spans=spans[order],
            positions=order,
            repeated=self._repeated,
            beside=self._values_beside(path),
            faulty=tuple(self._all_faults()),
        )

    def _values_beside(self, path: Path) -> dict[str, object]:
        values: dict[str, object] = {}
        if self._beside_bytes > _MOST_BESIDE:
            return values
        with open_regular(path) as file:
            for item in self._beside:
                content = item.read(file)
                with suppress(LayoutError):  # NaN, say; nothing depends on it
                    if not item.in_list:
                        values[item.key] = decode_value(content, self._name)
                        continue
                    others = values.setdefault(item.key, [])
                    if isinstance(others, list) and not item.is_empty:
                        others.append(decode_value(content, self._name))
        return values

    def _all_faults(self) -> Iterator[str]:
        for key, faults in self._faults.items():
            yield from faults[:_MOST_FAULTS]
            if len(faults) > _MOST_FAULTS:
                yield f"{key}: {len(faults) - _MOST_FAULTS:,} more like this"


def _id(item: JsonItem, key: str) -> CocoId:
    """The id under this key."""
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


def looks_like_coco(path: Path) -> bool:
    """Whether a file is one object with the lists that COCO has; never raises."""
    seen = set()
    try:
        with open_regular(path) as file:
            for item in read_object(file, path.name):
                seen.add(item.key)
                if seen.issuperset(LISTS):
                    return True
    except (LayoutError, OSError):
        return False
    return False
