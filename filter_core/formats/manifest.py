"""Unghost's own format: a JSONL file with one line per frame.

A line is the frame's annotation as given, its key, and the paths of its files. An
export leaves out rejected boxes and all paths but that of a copied image, and gives
each box its id; it changes nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, ClassVar, Final, TypeAlias

import numpy as np

from filter_core.errors import JsonError, LayoutError
from filter_core.formats.files import json_bytes
from filter_core.formats.format import (
    LABEL_NEEDS,
    SELECTION_OPTIONS,
    Format,
    Recognition,
    Source,
)
from filter_core.formats.reading import (
    KEYS_NAME,
    MANIFEST_NAME,
    MAX_KEY,
    MAX_LABEL_BYTES,
    BoxOrigin,
    FrameSet,
    FrameSource,
    is_inside,
    last_name,
    manifests_below,
    name_of,
    open_regular,
    walk,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.same import BoxSpan, spans_of_items
from filter_core.formats.streams.outside import OUTSIDE_FILES_HINT, allowed_folders
from filter_core.formats.writing import EVERY_KEY, ExportContext, OutFrame, Traits
from filter_core.json_text import read_json
from filter_core.values import JsonObject, shown

SEMANTIC_LIDAR_POINT: Final = np.dtype(
    [
        ("x", "<f4"), ("y", "<f4"), ("z", "<f4"),
        ("CosAngle", "<f4"), ("ObjIdx", "<u4"), ("ObjTag", "<u4"),
    ]
)  # fmt: skip
"""One point of a file under ``lidar``, as `carla.SemanticLidarMeasurement` gives it:
metres in the sensor's axes, the cosine of the angle of incidence, the actor hit and its
tag."""

MANIFEST: Final = Format(
    name="manifest",
    title="Unghost's own manifest",
    docs_row=(
        "`manifest.jsonl`: each [annotation](api.md#a-frames-annotation) as "
        "given, without the boxes that are rejected; unknown keys, 3D boxes and "
        "cameras included"
    ),
    brief="the annotations as uploaded, without the rejected boxes",
    recognised_by=MANIFEST_NAME,
    read_options=frozenset({"segmentation"}),
    needs=LABEL_NEEDS,
    options=SELECTION_OPTIONS,
)


@MANIFEST.recogniser
def _recognise(source: Source) -> Recognition:
    path = source.path
    if path.is_file():
        return "certain" if path.suffix.lower() == ".jsonl" else "none"
    if (path / MANIFEST_NAME).is_file():
        return "certain"
    return "none" if manifest_of(path) is None else "fallback"


def manifest_of(source: Path) -> Path | None:
    """The manifest of a folder, or the file itself; None if there is none.

    In a folder that is ``manifest.jsonl``, else the only one of this name in its
    sub-folders, else the only other ``.jsonl`` file in it.
    """
    if source.is_file():
        return source
    path = source / MANIFEST_NAME
    if path.is_file():
        return path
    names = [name for name in walk(source, (".jsonl",)) if last_name(name) != KEYS_NAME]
    manifests = manifests_below(source) or names
    return source / manifests[0] if len(manifests) == 1 else None


FRAME_FILES: Final = (
    "image",
    "segmentation",
    "depth",
    "instances",
    "lidar",
    "radar",
    "ignore_mask",
)
"""The files that a line may name, besides its boxes."""


@MANIFEST.reader
def read_manifest(source: Path, options: RecordingDescription) -> FrameSet:
    """The frames of a manifest, read line by line in its order.

    Paths are relative to the manifest's folder, or absolute. With
    ``options.segmentation``, relative segmentations are looked for in that folder. A
    file outside these folders is its frame's problem, unless the options allow it.
    Raises `LayoutError`: there is no such file, or it is a link to one outside the
    folder.
    """
    path = manifest_of(source)
    if path is None:
        raise LayoutError(f"expected {MANIFEST_NAME}, found no such file")
    allowed = allowed_folders(options, source)
    if allowed is not None and not is_inside(path, allowed):
        raise LayoutError(
            f"{name_of(source)}: expected a manifest in the folder, found {path.name}, "
            f"{_OUTSIDE}"
        )
    return FrameSet(
        layout="manifest",
        frames=lambda: _read_lines(path, options),
        texts=lambda: [path],
    )


_OUTSIDE: Final = f"which is or leads outside; {OUTSIDE_FILES_HINT}"


_FileAt: TypeAlias = Callable[[str, object, str], Path]
"""The path of a file of a frame, by its kind, its text and the line that has it."""


def _read_lines(path: Path, options: RecordingDescription) -> Iterator[FrameSource]:
    tags = options.segmentation or path.parent
    allowed = allowed_folders(options, path.parent)  # None: anywhere

    def file_at(kind: str, text: object, at: str) -> Path:
        """The path of one of `FRAME_FILES` as a line gives it; `at` is that line."""
        if not isinstance(text, str) or not text:
            raise LayoutError(f"{at}, {kind}: expected a path, found {shown(text)}")
        folder = tags if kind == "segmentation" else path.parent
        is_of_windows = "\\" in text and not (folder / text).exists()
        file_path = folder / (text.replace("\\", "/") if is_of_windows else text)
        if allowed is None or is_inside(file_path, allowed):
            return file_path
        raise LayoutError(
            f"{at}, {kind}: expected a file in the manifest's folder, found "
            f"{shown(text)}, {_OUTSIDE}"
        )

    with open_regular(path) as file:
        number = 0
        while line := file.readline(MAX_LABEL_BYTES + 1):
            number += 1
            at = f"{path.name}, line {number}"
            if len(line) > MAX_LABEL_BYTES:
                piece = line
                while piece and not piece.endswith(b"\n"):
                    piece = file.readline(MAX_LABEL_BYTES)
                yield _problem(at, f"at most {MAX_LABEL_BYTES} bytes", "more")
            elif line.strip():
                frame = _read_line(line, at, file_at)
                boxes = (frame.annotation or {}).get("boxes")
                count = len(boxes) if isinstance(boxes, list) else 0
                places = tuple((number - 1, box) for box in range(count))
                yield replace(frame, origin=BoxOrigin(path, places))


@MANIFEST.spans
def _spans(file: BinaryIO) -> Iterator[BoxSpan]:
    """The boxes of all lines that are objects."""
    begin = 0
    for number, line in enumerate(file):
        with suppress(LayoutError):  # the line is no frame
            spans = list(spans_of_items(BytesIO(line), "boxes", number))
            for place, start, end in spans:
                yield BoxSpan(place, begin + start, begin + end)
        begin += len(line)


def _read_line(line: bytes, at: str, file_at: _FileAt) -> FrameSource:
    try:
        raw = read_json(line.rstrip(), halves=True)
    except JsonError as exc:
        # The JSON is one line, so its own "line 1" is replaced by the line of the file.
        text = exc.found.replace("line 1, ", "", 1)
        return _problem(at, "one JSON object", text)
    if not isinstance(raw, dict):
        return _problem(at, "one JSON object", shown(raw))
    key = raw.pop("key", None)
    if not isinstance(key, str) or not 0 < len(key) <= MAX_KEY:
        return _problem(at, f'"key" of 1 to {MAX_KEY} characters', shown(key))
    try:
        files = {
            kind: file_at(kind, value, at)
            for kind in FRAME_FILES
            if (value := raw.pop(kind, None)) is not None
        }
        points = _plain_points(raw, at, file_at)
    except LayoutError as exc:
        return FrameSource(key=key, annotation=None, problem=exc)
    return FrameSource(
        key=key,
        annotation=raw,
        image=files.pop("image", None),
        segmentation=files.pop("segmentation", None),
        others=files,
        plain_points=points,
    )


def _plain_points(raw: JsonObject, at: str, file_at: _FileAt) -> Path | None:
    """The LiDAR points without tags of a capture, which ``extra.files`` names.

    That key may be anybody's, so what leads to no file in the folder is no problem.
    """
    extra = raw.get("extra")
    named = extra.get("files") if isinstance(extra, dict) else None
    if not isinstance(named, dict):
        return None
    with suppress(LayoutError):
        path = file_at(_PLAIN_POINTS, named.get(_PLAIN_POINTS), at)
        return path if path.is_file() else None
    return None


_PLAIN_POINTS: Final = "lidar_intensity"


def _problem(at: str, expected: str, found: str) -> FrameSource:
    error = LayoutError(f"{at}: expected {expected}, found {found}")
    return FrameSource(key=at, annotation=None, problem=error)


_OURS: Final = frozenset({"boxes", "key", *FRAME_FILES})


@MANIFEST.label_writer
class ManifestWriter:
    """Writes ``manifest.jsonl``; images are copied to ``images`` by `write_labels`.

    A box is written as it was given: its geometry in the same form, 3D boxes, cameras
    and every unknown key. Nothing is clipped.
    """

    traits: ClassVar[Traits] = Traits(
        image="images/{stem}{suffix}",
        can_hold_crowds=True,
        can_hold_unplaced=True,
        box_keys=EVERY_KEY,
        names_images=False,
    )

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._lines = context.spool()

    def labels(self, band: str, out: OutFrame) -> None:
        """One line."""
        frame = out.frame
        copied = self._context.options.images == "copy" and frame.read_image is not None
        annotation, ids = frame.given, frame.boxes.ids
        kept = {key: v for key, v in annotation.frame.items() if key not in _OURS}
        # A box without an id is identified by its position, which can change.
        rows = out.boxes.row.tolist()
        boxes = [{"id": ids[row], **annotation.boxes[row]} for row in rows]
        line = {
            "key": frame.key,
            **({"image": out.image} if copied else {}),
            **kept,
            "boxes": boxes,
        }
        self._lines.write(json_bytes(line, by_key=True) + b"\n")

    def finish(self) -> None:
        """The manifest, now that it is complete."""
        self._context.sink(MANIFEST_NAME, self._lines.pieces())
