"""Keys that file names cannot hold, from the list that an export brings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from filter_core.errors import JsonError, LayoutError
from filter_core.formats.manifest import MAX_KEY
from filter_core.formats.matching import FrameFiles, frame_key
from filter_core.formats.reading import MAX_LABEL_BYTES
from filter_core.formats.writing import KEYS_NAME
from filter_core.json_text import read_json


def with_keys(
    root: Path, frames: Sequence[FrameFiles], images: str = ""
) -> Sequence[FrameFiles]:
    """Frames under the keys that ``frames.jsonl`` gives them, with their maps.

    Parameters
    ----------
    root : Path
        The folder that may have the list.
    frames : sequence of FrameFiles
    images : str
        The folder of the images, where the keys of `frames` are relative to it.

    Returns
    -------
    sequence of FrameFiles
        In the order of the keys; as they were if there is no list.

    Raises
    ------
    LayoutError
        The list names a file or a key twice, or a line of it cannot be read.
    """
    path = root / KEYS_NAME
    if not path.is_file():
        return frames
    named = _read(path)
    renamed = (
        replace(one, key=found[0], map=found[1]) if found else one
        for one in frames
        for found in [named.get(f"{images}{one.key}")]
    )
    return sorted(renamed, key=lambda one: one.key)


def _read(path: Path) -> dict[str, tuple[str, str | None]]:
    named: dict[str, tuple[str, str | None]] = {}
    keys: set[str] = set()
    for at, line in _lines(path):
        file, key, town = line.get("file"), line.get("key"), line.get("map")
        if not isinstance(file, str) or not isinstance(key, str):
            raise LayoutError(f"{at}: expected file and key, found {str(line)[:60]}")
        if not 0 < len(key) <= MAX_KEY or not isinstance(town, (str, type(None))):
            raise LayoutError(f"{at}: expected a key and a map, found {str(line)[:60]}")
        name = frame_key(file)
        if name in named or key in keys:
            raise LayoutError(f"{at}: expected each once, found {str(line)[:60]} again")
        keys.add(key)
        named[name] = key, town
    return named


def _lines(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    with path.open("rb") as file:
        for number, line in enumerate(
            iter(lambda: file.readline(MAX_LABEL_BYTES), b"")
        ):
            at = f"{path.name}, line {number + 1}"
            try:
                value = read_json(line)
            except JsonError as exc:
                raise LayoutError(f"{at}: {exc.detail}") from exc
            if not isinstance(value, dict):
                raise LayoutError(f"{at}: expected an object")
            yield at, value
