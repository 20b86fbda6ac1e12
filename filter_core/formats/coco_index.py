"""Where the images and boxes of a COCO file are in it: a few numbers for each."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from filter_core.errors import LayoutError
from filter_core.formats.json_stream import Item, load, read_object
from filter_core.types import IntArray

LISTS: Final = ("images", "annotations", "categories")


@dataclass(frozen=True, eq=False)
class CocoIndex:
    """One COCO file, to be read image by image in any order of its boxes.

    Attributes
    ----------
    name : str
        As errors name it.
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
    names: dict[Any, str]
    places: IntArray
    owners: IntArray
    spans: IntArray
    repeated: dict[int, list[int]]

    def image(self, row: int) -> dict[str, Any]:
        """What the file says of one image."""
        with self.path.open("rb") as file:
            return self._load(file, self.places[row], f"images[{row}]")

    def boxes(self, row: int) -> Iterator[dict[str, Any]]:
        """The annotations of one image, in the order of the file."""
        first, last = np.searchsorted(self.owners, [row, row + 1])
        with self.path.open("rb") as file:
            for number in range(int(first), int(last)):
                start = int(self.spans[number, 0])
                yield self._load(
                    file, self.spans[number], f"the annotation at byte {start}"
                )

    @property
    def orphans(self) -> int:
        """Annotations of images that the file does not have."""
        return int((self.owners == -1).sum())

    def _load(self, file: Any, span: IntArray, at: str) -> dict[str, Any]:  # noqa: ANN401  # BinaryIO
        start, end = map(int, span)
        file.seek(start)
        value = load(file.read(end - start), f"{self.name}, {at}")
        if not isinstance(value, dict):
            raise LayoutError(f"{self.name}, {at}: expected an object")
        return value


def index_coco(path: Path, name: str) -> CocoIndex:
    """Read a file once and note where everything is.

    Raises
    ------
    LayoutError
        Not JSON, or without images, annotations and categories.
    """
    builder = _Builder(name)
    with path.open("rb") as file:
        for item in read_object(file, name):
            builder.add(item)
    return builder.index(path)


def looks_like_coco(path: Path) -> bool:
    """Whether a file is one object with the lists that COCO has; never raises."""
    seen = set()
    try:
        with path.open("rb") as file:
            for item in read_object(file, path.name):
                seen.add(item.key)
                if seen.issuperset(LISTS):
                    return True
    except (LayoutError, OSError):
        return False
    return False


class _Builder:
    def __init__(self, name: str) -> None:
        self._name = name
        self._rows: dict[Any, int] = {}
        self._repeated: dict[int, list[int]] = {}
        self._places = array("q")
        self._ids: list[Any] = []
        self._owners = array("q")
        self._spans = array("q")
        self._pending: dict[Any, int] = {}
        self._categories: list[Item] = []
        self._seen: set[str] = set()

    def add(self, item: Item) -> None:
        self._seen.add(item.key)
        if item.is_empty:
            return
        if item.key == "images":
            self._add_image(item)
        elif item.key == "annotations":
            self._add_annotation(item)
        elif item.key == "categories":
            self._categories.append(item)

    def _add_image(self, item: Item) -> None:
        number = self._id(item, "id")
        row = len(self._places) // 2
        self._places.extend((item.start, item.end))
        first = self._rows.setdefault(number, row)
        if first != row:
            self._repeated.setdefault(first, [first]).append(row)

    def _add_annotation(self, item: Item) -> None:
        # Ids become small numbers: annotations may come before the images.
        owner = self._id(item, "image_id")
        self._owners.append(self._pending.setdefault(owner, len(self._pending)))
        self._spans.extend((item.start, item.end))

    def _id(self, item: Item, key: str) -> Any:  # noqa: ANN401  # a number or text
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

    def _class_names(self, path: Path) -> dict[Any, str]:
        names: dict[Any, str] = {}
        with path.open("rb") as file:
            for item in self._categories:
                number = self._id(item, "id")
                file.seek(item.start)
                category = load(file.read(item.end - item.start), self._name)
                word = category.get("name")
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
