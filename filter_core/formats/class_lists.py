"""The class names that a dataset's own files give to its class numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from filter_core.config.file import parse_yaml
from filter_core.errors import ConfigError, JsonError, LayoutError
from filter_core.formats.reading import read_label_text
from filter_core.json_text import read_json

CARLASIMU_CLASSES: Final = ("car", "bus", "truck", "van", "walker", "street_light")
"""The order that carlasimu writes; it has no numbers for two-wheelers."""

_YAML_LISTS: Final = ("data.yaml", "data.yml", "dataset.yaml")

_TEXT_LISTS: Final = ("classes.txt", "labels.txt", "obj.names")


def find_class_list(root: Path) -> str | None:
    """The folder's file that lists classes, relative to it, if there is one.

    Some tools put it among the labels.
    """
    names = (*_YAML_LISTS, *_TEXT_LISTS)
    places = (*names, *(f"labels/{name}" for name in names))
    return next((name for name in places if (root / name).is_file()), None)


def yolo_classes(root: Path) -> tuple[str, ...]:
    """Class names from ``data.yaml`` or from a text file with one name per line.

    Raises
    ------
    LayoutError
        There is no such file, or it holds something else.
    """
    name = find_class_list(root)
    if name is None:
        raise LayoutError(
            f"expected the class names in one of {', '.join(_YAML_LISTS)} or "
            f"{', '.join(_TEXT_LISTS)}, found none of them"
        )
    text = read_label_text(root / name, name)
    if name.endswith(_TEXT_LISTS):
        return tuple(line.strip() for line in text.splitlines() if line.strip())
    try:
        document = parse_yaml(text)
    except ConfigError as exc:
        raise LayoutError(f"{name}: {exc.detail}") from exc
    names = document.get("names") if isinstance(document, Mapping) else None
    return _ordered(names, f"{name}, names")


def carlasimu_classes(root: Path) -> tuple[str, ...]:
    """Class names from carlasimu's ``Readme.txt``, else in the order of its code."""
    name = "Readme.txt"
    path = root / name
    if not path.is_file():
        return CARLASIMU_CLASSES
    try:
        document = read_json(read_label_text(path, name))
    except JsonError:
        # People put other readmes into folders; only carlasimu's own is JSON.
        return CARLASIMU_CLASSES
    numbers = document.get("classes") if isinstance(document, dict) else None
    if not isinstance(numbers, dict):
        return CARLASIMU_CLASSES
    return _ordered({number: word for word, number in numbers.items()}, name)


def _ordered(names: object, at: str) -> tuple[str, ...]:
    """Names in the order of their numbers, which must be 0, 1, 2 and so on."""
    if isinstance(names, Mapping):
        numbered = list(names.items())
        keys = [key for key, _ in numbered]
        if any(not isinstance(key, int) for key in keys) or sorted(keys) != list(
            range(len(keys))
        ):
            raise LayoutError(f"{at}: expected numbers from 0 up, found {keys[:8]}")
        names = [word for _, word in sorted(numbered)]
    if not isinstance(names, Sequence) or isinstance(names, str) or not names:
        raise LayoutError(f"{at}: expected a list of class names")
    for word in names:
        if not isinstance(word, str) or not word:
            raise LayoutError(f"{at}: expected a class name, found {str(word)[:40]!r}")
    return tuple(names)
