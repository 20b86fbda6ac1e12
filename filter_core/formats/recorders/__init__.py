"""Descriptions of the recordings of public recorders, which ship with the product.

Each ``.yaml`` file here is a description of a recording, with the recorder's name under
``recorder``. `recorder_of` finds the one that fits a folder, by names and content.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.resources import files
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple

from filter_core.config.file import parse_yaml
from filter_core.errors import FilterError
from filter_core.formats.reading import split_name, walk
from filter_core.formats.recording import values_of
from filter_core.formats.tables.box_rows import BoxReader
from filter_core.formats.tables.cameras import CameraPlaces
from filter_core.formats.tables.fields import BoxFields
from filter_core.formats.tables.patterns import (
    FRAME,
    LABELS,
    FilePatterns,
    PatternFiles,
    Values,
)
from filter_core.formats.tables.rows import MAX_BYTES, Lines, Row, read_document

_RUN: Final = "{run}"
"""Recordings may be in folders of their own."""

_LOOKED_AT: Final = 8
"""Label files whose content must fit."""

_ROWS_LOOKED_AT: Final = 64
"""Of a label file of many frames."""


class Recorder(NamedTuple):
    """A public recorder.

    `values` describe its recordings, by attribute of `RecordingDescription`.
    """

    name: str
    values: Mapping[str, object]

    @property
    def patterns(self) -> FilePatterns:
        """Where its files are."""
        patterns = self.values["files"]
        assert isinstance(patterns, FilePatterns), "each description has `files`"
        return patterns

    def below(self, folder: str) -> Recorder:
        """Its recordings in folders of that name."""
        cameras = self.values.get("cameras")
        values = {**self.values, "files": self.patterns.below(folder)}
        if isinstance(cameras, CameraPlaces):
            values["cameras"] = cameras.below(folder)
        return Recorder(self.name, values)


@cache
def recorders() -> tuple[Recorder, ...]:
    """The recorders that are known, in the order of their names."""
    all_recorders = []
    for file in sorted(files(__package__).iterdir(), key=lambda entry: entry.name):
        if file.name.endswith(".yaml"):
            document = parse_yaml(file.read_bytes())
            assert isinstance(document, dict), file.name
            all_recorders.append(
                Recorder(document.pop("recorder"), values_of(document))
            )
    return tuple(all_recorders)


def recorder_of(folder: Path) -> Recorder | None:
    """The recorder whose files these are, right in the folder or in folders in it."""
    if not folder.is_dir():
        return None
    all_recorders = recorders()
    paths = [*walk(folder, None)]
    suffixes = {split_name(path)[1].lower() for path in paths}
    for recorder in (*all_recorders, *(each.below(_RUN) for each in all_recorders)):
        labels = recorder.patterns.roles[LABELS]
        suffix = split_name(labels.text)[1]  # most recorders write another one
        if not {*"{}*/"} & {*suffix} and suffix.lower() not in suffixes:
            continue
        if not any(labels.match(path) is not None for path in paths):
            continue
        matched = PatternFiles(folder, recorder.patterns, paths)
        frames = matched.frames(None)
        if FRAME in labels.names:
            roles = recorder.patterns.roles.keys() & {
                "segmentation",
                "depth",
                "instances",
            }
            whole = (
                each
                for each in frames
                if each.files.label and roles <= each.files.files.keys()
            )
            files = [(each.files.label, each.values) for each in whole]
        else:
            files = [*matched.labels.items()] if frames else []
        looked_at = files[:_LOOKED_AT]
        if files and all(_fits(folder, recorder, *each) for each in looked_at):
            return recorder
    return None


def _fits(folder: Path, recorder: Recorder, name: str, values: Values) -> bool:
    """Whether a label file has boxes where the description says, or none at all."""
    fields = recorder.values.get("fields")
    cameras = recorder.values.get("cameras")
    if isinstance(cameras, CameraPlaces):
        names = (file.filled(values) for file in cameras.files)
        if not all((folder / file_name).is_file() for file_name in names):
            return False
    reader = BoxReader(fields if isinstance(fields, BoxFields) else BoxFields())
    try:
        if FRAME not in values:
            document = read_document(folder / name, name, MAX_BYTES)
            return all(_named_boxes(reader, document, name))
        document = read_document(folder / name, name)
        if isinstance(document, Lines):
            return False
        for class_name, row in reader.boxes_in(document, name):
            reader.box(row, class_name)
    except FilterError:
        return False
    return True


def _named_boxes(reader: BoxReader, document: object, name: str) -> Iterator[bool]:
    """Whether the first rows of a file of many frames say their frame; reads boxes."""
    lines = document if isinstance(document, Lines) else None
    rows: Iterable[tuple[object, Row]] = lines or reader.frames_in(document, name)
    for _, row in islice(rows, _ROWS_LOOKED_AT):
        if lines:
            reader.box(row)
        else:
            for class_name, box in reader.boxes_in(row.value, name):
                reader.box(box, class_name)
        yield reader.cell("frame", row.value) is not None
