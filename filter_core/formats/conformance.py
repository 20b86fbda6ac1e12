"""Tells the author of a format what is missing.

    python -m filter_core.formats.conformance MODULE[:NAME] [--example DIR]

MODULE declares a `Format`; NAME says which, if there are several. The example is a
small recording in this format: that of `--example`, else the path `EXAMPLE` of the
module. Each fault is a sentence; the exit code is 1 if there is one.
"""

from __future__ import annotations

import argparse
import importlib
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import ClassVar, Final, get_args

from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.format import FOLDER_OPTIONS, Format, Recognition, Source
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    RECORDING_NAME,
    FrameSet,
    FrameSource,
)
from filter_core.formats.recording import (
    READER_KEYS,
    RecordingDescription,
    describe,
    package_of,
    plugin_entries,
)
from filter_core.formats.registry import FORMATS, declared_format
from filter_core.formats.same import BoxSpans

_NAME: Final = re.compile(r"[a-z0-9][a-z0-9-]{0,39}")

_FOREIGN: Final = {
    "yolo": {
        "data.yaml": "names: [car]\n",
        "images/1.png": "",
        "labels/1.txt": "0 0.5 0.5 0.1 0.2\n",
    },
    "voc": {
        "Annotations/1.xml": "<annotation><object><name>car</name></object>"
        "</annotation>",
        "JPEGImages/1.jpg": "",
    },
    "kitti": {
        "training/label_2/000000.txt": "Car 0 0 -1.57 10 20 30 40 1.5 1.6 4 1 2 20 0\n",
        "training/image_2/000000.png": "",
    },
    "coco": {
        "instances.json": '{"images": [], "annotations": [], "categories": []}',
        "1.png": "",
    },
    "manifest": {"manifest.jsonl": '{"key": "1", "image": "1.png"}\n', "1.png": ""},
    "pairs": {"1.png": "", "1_seg.png": ""},
    "notes": {"README.txt": "Some notes about 3 pictures.\n", "notes.json": "{}"},
}
"""Folders in other formats, by the name of the format that is theirs."""

_DAMAGES: Final[dict[str, Callable[[bytes], bytes]]] = {
    "emptied": lambda content: b"",
    "cut in half": lambda content: content[: len(content) // 2],
    "replaced by bytes that are no text": lambda content: b"\xff\x00\xfe" * 20,
    "replaced by other text": lambda content: b"? ? ? ? ? ?\n",
}


def faults_of(candidate: Format, example: Path) -> Iterator[str]:
    """What is wrong with a format, as sentences; none if it conforms.

    `example` is a small recording in this format, a few frames with boxes.
    """
    yield from _faults_of_declaration(candidate)
    if candidate.recognise is None or candidate.read is None:
        return
    yield from _faults_of_recogniser(candidate, example)
    try:
        description = _description(example)
        frames = candidate.read(example, description)
        first, second = list(frames), list(frames)
        again = list(candidate.read(example, description))
    except Exception as error:  # of a foreign reader, which may do anything
        yield f"The reader fails with the example: {_in_words(error)}."
        return
    yield from _faults_of_frames(candidate, frames, first)
    # Keys that the reader uses, and that `read_source` would refuse before it does
    assert candidate.read is not None, "asked for without a reader"
    watched = _Watched()
    _Watched.looked_at.clear()
    with suppress(LayoutError):  # it may need what the example's description says
        list(candidate.read(example, watched))
    # The folders are looked at by what readers share, too.
    used = _Watched.looked_at - candidate.read_options - FOLDER_OPTIONS
    for option in sorted(used):
        yield f"The reader uses the option {option!r}; read_options does not list it."
    if candidate.box_spans is not None:
        yield from _faults_of_spans(candidate.box_spans, first)
    if first != second or first != again:
        yield (
            "The example's frames differ when they are read again; `frames` begins to "
            "read anew each time that it is called, in a fixed order."
        )
    yield from _faults_with_damage(candidate, example, first)


def _faults_of_declaration(candidate: Format) -> Iterator[str]:
    if not _NAME.fullmatch(candidate.name):
        yield (
            "name: expected 1 to 40 of a-z, 0-9 and dash, found "
            f"{candidate.name!r}, which --layout and addresses cannot have."
        )
    if FORMATS.get(candidate.name, candidate) is not candidate:
        yield f"name: Unghost has a format {candidate.name!r}; choose another name."
    if candidate.recognise is None:
        yield "The format has no function with the decorator `recogniser`."
    if candidate.read is None:
        yield "The format has no function with the decorator `reader`."
    yield from _faults_of_texts(candidate)


def _faults_of_texts(candidate: Format) -> Iterator[str]:
    packages = {
        package_of(entry) for entry in plugin_entries() if entry.name == candidate.name
    }
    if len(packages) > 1:
        yield f"name: {' and '.join(sorted(packages))} both have {candidate.name!r}."
    for attribute in ("title", "docs_row", "recognised_by"):
        text = getattr(candidate, attribute)
        if not text.strip() or "|" in text or "\n" in text:
            yield (
                f"{attribute}: expected a text of one line without '|', which "
                f"documents and messages show, found {text!r}."
            )
    for option in sorted(candidate.read_options - READER_KEYS):
        yield (
            f"read_options: {option!r} is no option of readers; these are "
            f"{', '.join(sorted(READER_KEYS))}."
        )


def _faults_of_recogniser(candidate: Format, example: Path) -> Iterator[str]:
    answer = _recognition(candidate, example)
    if answer not in get_args(Recognition):
        yield f"The recogniser answers {answer} for the example; {_ANSWERS}."
    elif answer == "none":
        yield "The recogniser answers 'none' for the example, which nobody then reads."
    with tempfile.TemporaryDirectory() as name:
        empty = Path(name, "empty")
        empty.mkdir()
        if (answer := _recognition(candidate, empty)) != "none":
            yield f"The recogniser answers {answer!r} for an empty folder; {_NONE}."
        note = Path(name, "note.txt")
        note.write_text("A note.\n", encoding="utf-8")
        if (answer := _recognition(candidate, note)) != "none":
            yield f"The recogniser answers {answer!r} for a note in a file; {_NONE}."
        for owner, files in _FOREIGN.items():
            for file, text in files.items():
                path = Path(name, owner, file)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
            answer = _recognition(candidate, Path(name, owner))
            if owner != candidate.name and answer not in ("none", "fallback"):
                yield (
                    f"The recogniser answers {answer!r} for a folder of {owner}, with "
                    f"{', '.join(files)}; {_NONE}."
                )


_NONE: Final = "expected 'none', since other folders would be taken for this format's"

_ANSWERS: Final = f"expected one of {', '.join(get_args(Recognition))}"


def _recognition(candidate: Format, source: Path) -> str:
    assert candidate.recognise is not None, "asked for without a recogniser"
    try:
        return candidate.recognise(Source(source))
    except Exception as error:  # of a foreign recogniser
        return f"with the error {_in_words(error)}"


def _description(example: Path) -> RecordingDescription:
    """That of the example; its layout cannot be a name that is not installed yet."""
    has_own = example.is_dir() and (example / RECORDING_NAME).is_file()
    return describe(example) if has_own else RecordingDescription()


def _faults_of_frames(
    candidate: Format, frames: FrameSet, read: list[FrameSource]
) -> Iterator[str]:
    if frames.layout != candidate.name:
        yield f"FrameSet.layout: expected {candidate.name!r}, found {frames.layout!r}."
    if frames.count not in (None, len(read)):
        yield f"FrameSet.count is {frames.count}, but {len(read)} frames are read."
    for key, times in Counter(frame.key for frame in read).items():
        if not key:
            yield "A key is empty; it names the frame."
        elif times > 1:
            yield f"The key {key!r} is that of {times} frames; each has its own."
    for frame in read:
        yield from (
            f"Frame {frame.key!r} of the example: {x}." for x in _faults_of(frame)
        )
    if not any((frame.annotation or {}).get("boxes") for frame in read):
        yield "The example has no box, so that reading boxes is not checked."


def _faults_of_spans(box_spans: BoxSpans, read: list[FrameSource]) -> Iterator[str]:
    """Boxes of the example that are not found in their label file."""
    for frame in read:
        boxes = (frame.annotation or {}).get("boxes")
        rows = range(len(boxes)) if isinstance(boxes, list) else range(0)
        if not rows:
            continue
        if frame.origin is None:
            yield f"Frame {frame.key!r} of the example has no origin, which spans need."
            continue
        try:
            with frame.origin.file.open("rb") as file:
                spans = list(box_spans(file))
        except Exception as error:  # of a foreign function
            yield f"box_spans fails with the example: {_in_words(error)}."
            continue
        there = {span.place for span in spans if span.start < span.end}
        if not there.issuperset(map(frame.origin.place, rows)):
            yield (
                f"Frame {frame.key!r} of the example: box_spans does not have the "
                f"places of all {len(rows)} boxes; it has {len(there)}."
            )


class _Watched(RecordingDescription):
    """A description that notes which of its keys a reader looks at."""

    looked_at: ClassVar[set[str]] = set()

    def __getattribute__(self, name: str) -> object:
        if name in READER_KEYS:
            _Watched.looked_at.add(name)
        return super().__getattribute__(name)


def _faults_of(frame: FrameSource) -> Iterator[str]:
    """What is wrong with a frame of an undamaged example."""
    if frame.problem is not None:
        yield frame.problem.detail
    elif frame.annotation is None:
        yield "neither an annotation nor a problem"
    else:
        try:
            parse_annotation(frame.annotation, frame=frame.key)
        except FilterError as error:
            yield f"its annotation is refused: {error.detail}"
    for path in (frame.image, frame.segmentation, *frame.others.values()):
        if path is not None and not path.is_file():
            yield f"{path} is not there"


def _faults_with_damage(
    candidate: Format, example: Path, first: list[FrameSource]
) -> Iterator[str]:
    """Each text of the example damaged in turn.

    That of one frame spoils this frame alone; any other may be a `LayoutError`.
    """
    if example.is_file():
        return
    own = [frame.label for frame in first if frame.label]
    texts = [
        path.relative_to(example).as_posix()
        for path in sorted(example.rglob("*"))
        if path.is_file()
        and not path.name.lower().endswith(IMAGE_SUFFIXES)
        and path.name != RECORDING_NAME
    ]
    with tempfile.TemporaryDirectory() as folder:
        damaged = Path(folder, "example")
        shutil.copytree(example, damaged)
        for name in texts:
            content = (example / name).read_bytes()
            is_of_frame = any(f"/{name}".endswith(f"/{label}") for label in own)
            for damage, change in _DAMAGES.items():
                (damaged / name).write_bytes(change(content))
                if (fault := _fault_with(candidate, damaged, is_of_frame)) is not None:
                    yield f"With {name} {damage}, {fault}."
            (damaged / name).write_bytes(content)


def _fault_with(candidate: Format, source: Path, is_of_frame: bool) -> str | None:
    assert candidate.read is not None, "asked for without a reader"
    try:
        frames = candidate.read(source, _description(source))
    except Exception as error:  # of a foreign reader
        # That of a file which belongs to all frames, such as a list of classes.
        if isinstance(error, LayoutError) and not is_of_frame:
            return None
        what = "the problem of its frame alone" if is_of_frame else "a LayoutError"
        return f"the reader fails with {_in_words(error)}; expected {what}"
    try:
        for frame in frames:
            if frame.annotation is not None:
                with suppress(FilterError):
                    parse_annotation(frame.annotation, frame=frame.key)
    except Exception as error:  # of a foreign reader
        return (
            f"reading frames ends with {_in_words(error)}; expected the `problem` of a "
            "frame, so that the others are read (`annotated`)"
        )
    return None


def _in_words(error: Exception) -> str:
    detail = error.detail if isinstance(error, FilterError) else str(error)
    return f"{type(error).__name__}: {detail}"


def main(words: list[str] | None = None) -> int:
    """The command; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m filter_core.formats.conformance",
        description="Tells the author of a format what is missing.",
    )
    parser.add_argument("module", metavar="MODULE[:NAME]")
    parser.add_argument("--example", metavar="DIR", type=Path)
    options = parser.parse_args(words)
    name, _, attribute = options.module.partition(":")
    faults = list(_faults_of_module(name, attribute, options.example))
    for fault in faults:
        sys.stdout.write(f"{fault}\n")
    if not faults:
        sys.stdout.write(f"{options.module} conforms.\n")
    return 1 if faults else 0


def _faults_of_module(name: str, attribute: str, example: Path | None) -> Iterator[str]:
    try:
        module = importlib.import_module(name)
        candidate = declared_format(getattr(module, attribute) if attribute else module)
    except Exception as error:  # of a foreign module
        yield f"{name} declares no format that can be used: {_in_words(error)}."
        return
    place = example or getattr(module, "EXAMPLE", None)
    if place is None or not Path(place).exists():
        yield from _faults_of_declaration(candidate)
        yield (
            f"There is no example {place or ''}: expected a small recording in this "
            f"format, named by --example DIR or by EXAMPLE in {name}."
        )
        return
    yield from faults_of(candidate, Path(place))


if __name__ == "__main__":
    sys.exit(main())
