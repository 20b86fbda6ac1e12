"""Images with their segmentations and, if there is a file, their annotations.

A segmentation has the name of its image, in a folder of its own (``seg/1.png``), or is
in the same folder with an ending (``1_seg.png``). ``1.json`` is the annotation of
``1.png``, as for an upload; an image without one is a frame without boxes. In a folder
without pictures, segmentations and instance images are the frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import BinaryIO, Final

from filter_core.formats.format import FOLDER_OPTIONS, Format, Recognition, Source
from filter_core.formats.matching import FileIndex, FrameFileNames, frame_of
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    BoxOrigin,
    FrameSet,
    FrameSource,
    Unmatched,
    annotated,
    frame_key,
    is_label,
    json_object,
    manifests_below,
    read_label_bytes,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.same import BoxSpan, spans_of_items
from filter_core.formats.streams import Streams
from filter_core.formats.tables.patterns import LABELS, described_frames

PAIRS: Final = Format(
    name="pairs",
    title="Images and segmentations",
    docs_row=(
        "images, their segmentations in `seg/` or beside them as `NAME_seg.png`, and "
        "each frame's [annotation](api.md#a-frames-annotation) as `NAME.json`, where "
        "there is one"
    ),
    recognised_by="images, in a folder of no other layout",
    read_options=FOLDER_OPTIONS | {"key"},
)


@PAIRS.recogniser
def _recognise(source: Source) -> Recognition:
    root = source.path
    # Labels of an unknown layout must not be ignored silently, nor must manifests.
    if root.is_file() or any(is_label(root, name) for name in source.label_files):
        return "none"
    if manifests_below(root):
        return "none"
    return "fallback" if any(True for _ in source.names(IMAGE_SUFFIXES)) else "none"


@PAIRS.reader
def read_pairs(root: Path, options: RecordingDescription) -> FrameSet:
    """A frame for each picture; an annotation that cannot be read is its problem.

    Label files of other layouts, and images in a folder of another sensor, are listed
    as unmatched.
    """
    if options.key or LABELS in options.files.roles:
        return _by_patterns(root, options)
    labels = options.labels or root
    streams = Streams(root, options)
    images = FileIndex(streams.images)
    names = partial(options.files.walk, root, labels)
    annotations = FileIndex(names((".json",)))
    pictures = [FrameFileNames(key, "", image) for key, image in images]
    files, left_over = streams.complete(
        pictures or sorted(streams.without_pictures(), key=lambda frame: frame.key),
        "image",
    )
    frames = []
    for file_names in files:
        alone = images.is_only_base(file_names.key)
        annotation = annotations.take(file_names.key, by_base=alone)
        if annotation is None and file_names.image is None:
            annotation = annotations.take(frame_key(file_names.label))
        frame = replace(frame_of(file_names, root), label=None)
        if annotation is None:
            frame = replace(frame, annotation={**(frame.annotation or {}), "boxes": []})
        frames.append((frame, annotation))
    unmatched = (
        *images.unmatched,
        *left_over,
        *annotations.left_over("no image of this name"),
        *(
            Unmatched(name, "labels of another layout are not read with images")
            for name in names((".txt", ".xml", ".csv", ".tsv", ".npz"))
            if is_label(labels, name)
        ),
    )
    return FrameSet(
        layout="pairs",
        frames=lambda: _read_frames(labels, frames),
        count=len(frames),
        unmatched=unmatched,
        notes=partial(tuple, streams.notes),
        streams=streams.facts,
        texts=lambda: (labels / name for _, name in frames if name),
    )


def _by_patterns(root: Path, options: RecordingDescription) -> FrameSet:
    """Of annotations no pattern need speak: ``1.json`` is that of ``1.png``."""
    matched, unmatched = described_frames(root, options.files, options.key)
    is_described = LABELS in options.files.roles
    names = options.files.walk(root, root, (".json",))
    annotations = FileIndex(() if is_described else names)
    frames = []
    for files, _ in matched:
        label = files.label or annotations.take(frame_key(files.image or ""))
        frame = replace(frame_of(files, root), label=None)
        if not label:
            frame = replace(frame, annotation={**(frame.annotation or {}), "boxes": []})
        frames.append((frame, label or None))
    used = {label for _, label in frames}
    return FrameSet(
        layout="pairs",
        frames=lambda: _read_frames(root, frames),
        count=len(frames),
        unmatched=tuple(file for file in unmatched if file.path not in used),
    )


def _read_frames(
    labels: Path, frames: Sequence[tuple[FrameSource, str | None]]
) -> Iterator[FrameSource]:
    """Each frame with what its file of the labels' folder says, if it has one."""
    for frame, name in frames:
        if name is None:
            yield frame
        else:
            frame = replace(frame, origin=BoxOrigin(labels / name))
            yield annotated(frame, partial(_annotation, labels / name, name))


def _annotation(path: Path, name: str) -> dict[str, object]:
    return json_object(read_label_bytes(path, name), name, halves=True)


@PAIRS.spans
def _spans(file: BinaryIO) -> Iterator[BoxSpan]:
    """The boxes of an annotation."""
    return spans_of_items(file, "boxes")
