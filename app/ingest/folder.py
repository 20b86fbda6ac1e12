"""Finds the frames in a folder that a person dropped on the page. Stores none of them.

The page sends the files as a tar: text files as they are, some images whole, and of all
others the name alone or, where readers need the size, the first bytes. The files are
written to a temporary folder (`SentFolder`), under their names if these are safe
(`_why_not`). A child process reads that with the readers of ``unghost push``, inspects
it as ``unghost inspect`` does, and writes the response next to it (`write_response`).
The files are untrusted, so the child has limits on memory and time
(`app.engine.children`).
"""

from __future__ import annotations

import json
import os
import re
import shutil
import struct
import tempfile
from base64 import b64encode
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from app.errors import TooLarge
from filter_core.config.file import parse_yaml
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.kitti import KITTI
from filter_core.formats.manifest import MANIFEST, manifest_of
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    NOTES_SUFFIXES,
    RECORDING_NAME,
    TEXT_SUFFIXES,
    FrameSet,
    FrameSource,
    is_hidden,
    missing_image,
    read_label_bytes,
    split_name,
)
from filter_core.formats.recording import COMPANIONS, description_document
from filter_core.formats.registry import (
    FORMATS,
    describe_source,
    layout_format,
    possible_layouts,
)
from filter_core.formats.same import companions, folder_of, with_labels
from filter_core.formats.table import TABLE
from filter_core.images.header import read_image_size
from filter_core.images.png import SIGNATURE
from filter_core.inspection.pictures import DrawnFrame
from filter_core.inspection.recording import (
    Inspection,
    OpenedRecording,
    Sampling,
    inspect_opened,
    open_recording,
)
from filter_core.inspection.remarks import by_role, facts, recording_text, remarks_on
from unghost.wire import folders as wire
from unghost.wire.model import Fault, ResponseModel

PREFIX: Final = "folder-"
"""Prefix of the names of temporary folders, each with the files and the response."""
ROOT: Final = "these files"
"""The name of the folder in error messages, if the sent files have no common folder."""
MOST_NAME_BYTES: Final = 1024
"""Maximum length of the path of a file."""
MOST_PART_BYTES: Final = 255
"""Maximum length of the name of a file or folder, as in most file systems."""
MOST_DEPTH: Final = 32
"""Maximum depth of nested folders."""
MOST_LONGER: Final = 4
"""Maximum size of the response, as a multiple of the maximum size of the folder."""
_NOT_WHOLE: Final = (0, 24, 64 * 1024)
"""Sizes in bytes of images of which only the name was sent, or what has the size of a
PNG or a JPEG. (No PNG has 24 bytes.)"""
_LOOKING: Final = 2
"""Threads that look at pictures."""
_NO_NAMES: Final = frozenset({"", ".", ".."})
"""Parts of a path that name no file or folder in the one before them."""
_DEVICE: Final = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)
"""Names reserved for devices on Windows, with any suffix."""


class SentFolder:
    """A temporary folder with the files that are being received.

    A file that cannot be written there is listed in `refused`; the others are kept.
    `absent` are the images that were not sent whole. `most_files` limits the number of
    files and folders together, and `most_file_bytes` the size of a file, as when the
    archive is read. It is pickled for the child process that reads the folder.
    """

    def __init__(self, parent: Path, most_files: int, most_file_bytes: int) -> None:
        self._place = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        self.root = self._place / ROOT
        self.root.mkdir()
        self._empty = self._place / "empty"
        self._empty.touch()
        self.response = self._place / "response.jsonl"
        self.refused: list[tuple[str, str]] = []
        self.absent: list[str] = []
        self._most_files, self._most_file_bytes = most_files, most_file_bytes
        self._folders: set[str] = {""}
        self._files = 0

    def add(self, name: str, content: bytes | None) -> None:
        """Write a file, whose content is None if it is larger than allowed.

        TooLarge if there are more files and folders than allowed.
        """
        why = _why_not(name, self.root)
        if why is None and content is None:
            why = f"larger than {self._most_file_bytes} bytes"
        if why is None:
            why = self._write(name, content or b"")
        if why is not None:
            self.refused.append((name, why))
        elif (
            len(content or b"") in _NOT_WHOLE
            and split_name(name)[1].lower() in IMAGE_SUFFIXES
        ):
            self.absent.append(name)
        self._files += 1
        if self._files + len(self._folders) - 1 > self._most_files:
            raise TooLarge(
                f"the folder has more than {self._most_files} files and folders; "
                "unghost push takes any number"
            )

    def _write(self, name: str, content: bytes) -> str | None:
        path = f"{self.root}{os.sep}{name}"
        folder = name.rpartition("/")[0]
        try:
            if folder not in self._folders:
                Path(path).parent.mkdir(parents=True, exist_ok=True)
                self._note(folder)
            if content or not self._link_empty(path):
                with Path(path).open("xb") as file:
                    file.write(content)
        except (FileExistsError, NotADirectoryError):
            return "another file has this name, or one that is equal on the server"
        except (OSError, ValueError):
            if shutil.disk_usage(self.root).free < len(content):
                raise
            return "no file can have this name on the server"
        return None

    def _link_empty(self, path: str) -> bool:
        """Link an empty file, as most are; it takes a fraction of a new file's time.

        False if the system has no such links, or allows no more (ext4: 65,000).
        """
        try:
            os.link(self._empty, path)
        except (FileExistsError, NotADirectoryError):
            raise
        except OSError:
            return False
        return True

    def _note(self, folder: str) -> None:
        while folder and folder not in self._folders:
            self._folders.add(folder)
            folder = folder.rpartition("/")[0]

    def remove(self) -> None:
        """Delete the folder and the response."""
        shutil.rmtree(self._place, ignore_errors=True)


def _why_not(name: str, root: Path) -> str | None:
    """Why no file of this name may be written; None if it may."""
    parts = name.split("/")
    # By the rules of this system: on Windows a backslash or a drive leads elsewhere.
    is_plain = os.sep == "/" and _NO_NAMES.isdisjoint(parts)
    is_outside = not is_plain and (
        name.startswith("../") or _relative(root / name, root) != name
    )
    if "\0" in name or is_outside:
        return "its name leads out of the folder"
    if any(map(_DEVICE.match, parts)):
        return "its name is reserved for a device on Windows"
    sizes = [len(part.encode()) for part in parts]
    if max(sizes) > MOST_PART_BYTES or sum(sizes) > MOST_NAME_BYTES:
        return "its name is too long"
    return "it is nested too deep" if len(parts) > MOST_DEPTH else None


def write_response(sent: SentFolder, layout: str, most_bytes: int) -> int:
    """Read a folder, inspect it, and write the response, as lines of JSON.

    `layout` is one of `LAYOUTS`, or a plug-in's name; ``auto`` chooses the likeliest.
    A folder that cannot be read has no frames; its inspection says why. Returns the
    size of the response in bytes, at most `most_bytes`. Raises LayoutError: there is a
    fault in ``recording.yaml``, or the response would be too large.
    """
    # The only folder there, if there is nothing else.
    visible = [path for path in sent.root.iterdir() if not is_hidden(path.name)]
    only = visible[0] if len(visible) == 1 else sent.root
    source = only if only.is_dir() else sent.root
    # There are no links here, and `_name_of` refuses every file that was not sent: its
    # message fits the page better than the reader's, which names an option.
    named = {} if layout == "auto" else {"layout": layout}
    description = describe_source(source, options={"outside_files": None, **named})
    opened = open_recording(source, description)
    if opened.layout == KITTI.name or description.cameras.places:
        opened = _with_sizes(opened, sent)
    layouts = opened.layouts
    if description.own_layout != "auto":
        layouts = possible_layouts(source, description) or layouts
    settings = description.segmentation_settings()
    with _Response(sent, source, most_bytes) as response:
        response.write(
            wire.FolderHead.model_validate(
                {
                    "layout": opened.layout,
                    "layouts": layouts,
                    "titles": {
                        name: layout_format(name).title
                        for name in (*layouts, opened.layout)
                        if name is not None
                    },
                    "classes": opened.frames.classes,
                    "settings": settings,
                    "config": {
                        name: value
                        for name, value in description.config_keys().items()
                        if name not in settings
                    },
                    "count": opened.frames.count,
                }
            )
        )
        inspection = inspect_opened(
            source,
            response.writing_frames(opened),
            Sampling(
                absent={f"{sent.root}{os.sep}{name}" for name in sent.absent},
                workers=_LOOKING,
            ),
        )
        response.write_unmatched(opened.frames)
        response.write(
            wire.FolderEnd(
                end=True,
                frames=response.frames,
                faulty=response.faulty,
                unmatched=response.unmatched,
                notes=list(inspection.notes),
                inspection=_shown(inspection, source, opened.frames, response),
            )
        )
        return response.size


def _with_sizes(opened: OpenedRecording, sent: SentFolder) -> OpenedRecording:
    """A recording whose cameras need the size of each image, also of those not sent.

    They get that of the images in their folder that were sent whole, if all of these
    have the same; the upload compares it with the image.
    """
    absent: dict[Path, list[Path]] = {}
    for name in sent.absent:
        path = sent.root / name
        if not path.stat().st_size:
            absent.setdefault(path.parent, []).append(path)
    notes, frames = [], opened.frames
    for folder, paths in absent.items():
        sizes = set()
        for path in folder.iterdir():
            with suppress(FilterError, OSError):
                sizes.add(read_image_size(path.read_bytes()))
        if len(sizes) != 1:
            continue
        width, height = sizes.pop()
        head = SIGNATURE + struct.pack(">I4sII", 13, b"IHDR", width, height)
        for path in paths:
            path.unlink()  # all empty files are links to one
            path.write_bytes(head)
        notes.append(
            f"{len(paths)} images such as {_relative(paths[0], sent.root)} are taken "
            f"to have the size of those beside them, {width} x {height} px"
        )
    with_sizes = replace(frames, notes=lambda: (*frames.notes(), *notes))
    return replace(opened, frames=with_sizes)


def _shown(
    inspection: Inspection, source: Path, frames: FrameSet, response: _Response
) -> wire.FolderInspection:
    """An inspection as the response has it, when all frames are written."""
    path, own = source / RECORDING_NAME, None
    if path.is_file():
        own = parse_yaml(read_label_bytes(path, path.name))
    root = response.sent.root
    used = Counter(folder_of(f"{root}{os.sep}{name}") for name in response.used)
    left = companions(source, frames, used)
    palette = inspection.segmentation and inspection.segmentation.family
    return wire.FolderInspection(
        why=inspection.why,
        remarks=tuple(
            wire.FolderRemark(
                text=remark.text,
                finding=remark.finding,
                remedies=tuple(
                    wire.FolderRemedy(place=place, value=value)
                    for place, value in remark.remedies
                ),
                unknown_classes=remark.unknown_classes,
                is_serious=remark.is_serious,
            )
            for remark in remarks_on(inspection)
        ),
        facts=tuple(
            wire.FolderFact(name=name, text=text) for name, text in facts(inspection)
        ),
        streams=tuple(
            wire.FolderStream(
                role=stream.role,
                images=stream.images,
                example=f"{response.top}{stream.example}",
                told_by=stream.told_by,
                pattern=stream.pattern,
            )
            for stream in by_role(inspection)
        ),
        classes=tuple(
            wire.FolderClass(
                name=labels.name,
                boxes=labels.boxes,
                measured_as=labels.measured_as,
                nearest=labels.nearest,
                tags=labels.tags,
                kept=labels.kept,
                rejected=labels.looked_at.rejected,
                unmeasured=labels.unmeasured,
                unknown_percent=labels.unknown_percent,
            )
            for labels in inspection.classes
        ),
        looked_at=inspection.pictures,
        painted=tuple(map(_painted, inspection.drawn)),
        palette=palette,
        given=json.loads(json.dumps(own or {}, default=str)),
        read_with={
            **description_document(inspection.described, source),
            **({COMPANIONS: left} if left else {}),
        },
        recording=recording_text(inspection, source),
    )


def _painted(frame: DrawnFrame) -> wire.PaintedFrame:
    width, height = frame.wh
    return wire.PaintedFrame(
        key=frame.key,
        width=width,
        height=height,
        jpeg=None if frame.jpeg is None else b64encode(frame.jpeg).decode(),
        boxes=tuple(
            wire.PaintedBox.model_validate(box._asdict()) for box in frame.boxes
        ),
    )


@dataclass
class _Response:
    """Writes the lines of the response, and counts them."""

    sent: SentFolder
    source: Path
    most_bytes: int
    layout: str = ""
    frames: int = 0
    faulty: int = 0
    unmatched: int = 0
    size: int = 0
    used: set[str] = field(default_factory=set)

    def __enter__(self) -> _Response:
        self._file = self.sent.response.open("wb")
        prefix = f"{self.sent.root}{os.sep}"
        self._names = {
            f"{folder}{os.sep}{name}".removeprefix(prefix).replace(os.sep, "/")
            for folder, _, files in os.walk(self.sent.root)
            for name in files
        }
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    @property
    def top(self) -> str:
        """What stands before the names of files in the folder that is read."""
        name = _relative(self.source, self.sent.root)
        return "" if name == "." else f"{name}/"

    def write(self, line: ResponseModel) -> None:
        self._write(_json(line.model_dump()))

    def _write(self, line: bytes) -> None:
        self.size += len(line) + 1
        if self.size > self.most_bytes:
            raise LayoutError(
                f"the description of this folder is larger than {self.most_bytes} "
                "bytes; unghost push takes folders of any size"
            )
        self._file.write(line + b"\n")

    def writing_frames(self, opened: OpenedRecording) -> OpenedRecording:
        """The same recording, whose frames are written when they are read.

        If its boxes look like something that only a person can say, no frame with boxes
        is used before it is said.
        """
        frames = opened.frames
        self.layout = frames.layout
        doubt = next(iter(opened.others), None)

        def written() -> Iterator[FrameSource]:
            for frame in frames:
                has_boxes = bool((frame.annotation or {}).get("boxes"))
                self._write_frame(frame, doubt if has_boxes else None)
                yield frame

        return replace(opened, frames=replace(frames, frames=written))

    def _write_frame(self, source: FrameSource, doubt: LayoutError | None) -> None:
        self.frames += 1
        try:
            line = self._frame(source, doubt)
        except LayoutError as error:
            self.faulty += 1
            frame = wire.FolderFrame(
                key=source.key,
                annotation=None,
                annotation_text=None,
                files={},
                fault=Fault(
                    pointer=error.pointer, code=error.kind, detail=error.detail
                ),
            )
            line = _json(frame.model_dump())
        self._write(line)

    def _frame(self, source: FrameSource, doubt: LayoutError | None) -> bytes:
        if problem := source.problem or missing_image(source) or doubt:
            raise LayoutError(
                problem.detail, pointer=problem.pointer, code=problem.kind
            )
        paths = {"image": source.image, "segmentation": source.segmentation}
        paths |= source.others
        files = {
            kind: self._name_of(kind, path)
            for kind, path in paths.items()
            if path is not None
        }
        self.used.update(files.values())
        annotation = with_labels(source, self.layout)
        # As the fields of `FolderFrame`, which are not checked one by one.
        frame: dict[str, object] = {
            "key": source.key,
            "annotation": annotation,
            "annotation_text": None,
            "files": files,
            "fault": None,
        }
        line = _json(frame)
        # Of a name or an annotation; mostly there is none, and the line is done.
        if _LONG_INTEGER.search(line):
            text = json.dumps(annotation)
            if _LONG_INTEGER.search(text.encode()):
                return _json(frame | {"annotation_text": text})
        return line

    def _name_of(self, kind: str, path: Path) -> str:
        """The name of a sent file; a manifest may name files that were not sent."""
        name = _relative(path, self.sent.root)
        if name in self._names:
            return name
        inside = path.is_relative_to(self.source)
        shown = path.relative_to(self.source) if inside else path
        raise LayoutError(f"{kind}: {shown} is not among these files")

    def write_unmatched(self, frames: FrameSet) -> None:
        listed = [(file.path, file.why) for file in frames.unmatched]
        strange = self._strange(frames.layout, {path for path, _ in listed})
        for path, why in (*self.sent.refused, *listed, *strange):
            self.unmatched += 1
            self.write(wire.UnmatchedFile(path=path, why=why))

    def _strange(self, layout: str, listed: set[str]) -> Iterator[tuple[str, str]]:
        """Files that belong to no frame, and that no reader of the layout opens."""
        # A plug-in may open any text.
        has_notes = layout in FORMATS and layout != TABLE.name
        own = NOTES_SUFFIXES if has_notes else TEXT_SUFFIXES
        manifest = manifest_of(self.source) if layout == MANIFEST.name else None
        used = {
            *self.used,
            *([_relative(manifest, self.sent.root)] if manifest else []),
            _relative(self.source / RECORDING_NAME, self.sent.root),
        }
        for name in sorted(self._names - used):
            if any(map(is_hidden, name.split("/"))):
                continue
            shown = name.removeprefix(self.top)
            if manifest is not None:
                yield shown, "no line of the manifest names it"
            elif shown not in listed and not name.lower().endswith(
                (*IMAGE_SUFFIXES, *own)
            ):
                yield shown, "neither an image nor a label"


def _relative(path: Path, root: Path) -> str:
    text, prefix = str(path), f"{root}{os.sep}"
    # Most paths only begin with that of the folder, and there may be many thousands.
    if text.startswith(prefix) and ".." not in text:
        return text[len(prefix) :].replace(os.sep, "/")
    return os.path.relpath(path, root).replace(os.sep, "/")


_LONG_INTEGER: Final = re.compile(rb"(?<![\d.])\d{16,}(?![\d.eE])")
"""A whole number in JSON that may be beyond 2^53, of which the page would lose digits;
also in a text."""


def _json(line: dict[str, object]) -> bytes:
    try:
        # ASCII: a key can have lone surrogates, which UTF-8 cannot encode.
        return json.dumps(line, allow_nan=False).encode()
    except ValueError as exc:
        # JSON has neither NaN nor infinity, but 1e999 is read as one.
        raise LayoutError(
            "expected finite numbers in the annotation, found one that is NaN or too "
            "large"
        ) from exc
