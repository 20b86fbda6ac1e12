"""Descriptions of the recordings of public recorders, which ship with the product.

Each ``.yaml`` file here is a description of a recording, with the recorder's name under
``recorder``. `recorder_of` finds the one that fits a folder, by names and content.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final, NamedTuple

from filter_core.config.file import parse_yaml
from filter_core.errors import FilterError
from filter_core.formats.box_rows import BoxReader
from filter_core.formats.cameras import CameraPlaces
from filter_core.formats.fields import BoxFields
from filter_core.formats.patterns import (
    LABELS,
    FilePatterns,
    PatternFiles,
    PatternFrame,
)
from filter_core.formats.reading import walk
from filter_core.formats.recording import values_of
from filter_core.formats.rows import Lines, read_document

_RUN: Final = "{run}"
"""Recordings may be in folders of their own."""

_LOOKED_AT: Final = 8
"""Label files whose content must fit."""


class Recorder(NamedTuple):
    """A public recorder.

    Attributes
    ----------
    name : str
    values : mapping of str to object
        The description of its recordings, by attribute of `RecordingDescription`.
    """

    name: str
    values: Mapping[str, object]

    @property
    def patterns(self) -> FilePatterns:
        """Where its files are."""
        found = self.values["files"]
        assert isinstance(found, FilePatterns), "each description has `files`"
        return found

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
    return tuple(_loaded())


def _loaded() -> Iterator[Recorder]:
    folder = files(__package__)
    for file in sorted(folder.iterdir(), key=lambda one: one.name):
        if file.name.endswith(".yaml"):
            document = parse_yaml(file.read_bytes())
            assert isinstance(document, dict), file.name
            yield Recorder(document.pop("recorder"), values_of(document))


def recorder_of(folder: Path) -> Recorder | None:
    """The recorder whose files these are, right in the folder or in folders in it."""
    if not folder.is_dir():
        return None
    known = recorders()
    paths = [*walk(folder, None)]
    for one in (*known, *(each.below(_RUN) for each in known)):
        labels = one.patterns.roles[LABELS]
        if not any(labels.match(path) is not None for path in paths):
            continue
        frames = PatternFiles(folder, one.patterns, paths).frames(None)
        roles = one.patterns.roles.keys() & {"segmentation", "depth", "instances"}
        whole = [each for each in frames if _is_whole(each, roles)][:_LOOKED_AT]
        if whole and all(_fits(folder, one, each) for each in whole):
            return one
    return None


def _is_whole(frame: PatternFrame, roles: set[str]) -> bool:
    return bool(frame.files.label) and roles <= frame.files.files.keys()


def _fits(folder: Path, recorder: Recorder, frame: PatternFrame) -> bool:
    """Whether a label file has boxes where the description says, or none at all."""
    fields, name = recorder.values.get("fields"), frame.files.label
    cameras = recorder.values.get("cameras")
    if isinstance(cameras, CameraPlaces):
        names = (one.filled(frame.values) for one in cameras.files)
        if not all((folder / one).is_file() for one in names):
            return False
    reader = BoxReader(fields if isinstance(fields, BoxFields) else BoxFields())
    try:
        document = read_document(folder / name, name)
        if isinstance(document, Lines):
            return False
        for class_name, row in reader.boxes_in(document, name):
            reader.box(row, class_name)
    except FilterError:
        return False
    return True
