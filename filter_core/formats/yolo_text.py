"""Lines of YOLO label files, and the raw centre pixels that carlasimu's sample has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from filter_core.errors import LayoutError
from filter_core.formats.label_numbers import read_columns

_WITH_CONFIDENCE: Final = 6

_YOLO_COLUMNS: Final = (5, _WITH_CONFIDENCE)

_RAW_COLUMNS: Final = 4


def read_label_lines(
    text: str, name: str, classes: Sequence[str], default_class: str
) -> list[dict[str, object]]:
    """The boxes of one label file, as annotations.

    Parameters
    ----------
    text : str
        Per line ``class cx cy w h`` (shares of the image; a sixth column is kept as
        ``confidence``), or ``cx cy w h`` in pixels without a class.
    name : str
        The file, as errors name it.
    classes : sequence of str
        Names by index.
    default_class : str
        The class of lines that carry none.

    Raises
    ------
    LayoutError
        Names file, line, what was expected and what was found.
    """
    boxes = []
    for number, line in enumerate(text.splitlines(), start=1):
        columns = line.split()
        if columns:
            at = f"{name}, line {number}"
            boxes.append(_read_line(columns, at, classes, default_class))
    return boxes


def _read_line(
    columns: list[str], at: str, classes: Sequence[str], default_class: str
) -> dict[str, object]:
    if len(columns) == _RAW_COLUMNS:
        return {"class": default_class, "cxcywh": read_columns(columns, at)}
    if len(columns) not in _YOLO_COLUMNS:
        raise LayoutError(
            f"{at}: expected 'class cx cy w h' (5 columns) or 'cx cy w h' in pixels "
            f"(4 columns), found {len(columns)} columns"
        )
    box: dict[str, object] = {
        "class": _class_name(columns[0], at, classes),
        "cxcywhn": read_columns(columns[1:5], at),
    }
    if len(columns) == _WITH_CONFIDENCE:
        box["confidence"] = read_columns(columns[5:], at)[0]
    return box


def _class_name(word: str, at: str, classes: Sequence[str]) -> str:
    if word.isascii() and word.isdigit() and len(word) < 10:
        index = int(word)
        if index < len(classes):
            return classes[index]
    raise LayoutError(
        f"{at}: expected a class from 0 to {len(classes) - 1}, found {word[:40]!r}"
    )
