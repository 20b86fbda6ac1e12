"""Finds the frames in a folder that a person dropped on the page. Stores none of them.

The page sends the files as a tar: text files as they are, other files without content,
since readers of folders need only their names. (KITTI's reader needs the sizes of its
images; so the page sends their first bytes.) The files are written to a temporary
folder (`SentFolder`), under their names if these are safe (`_why_not`). A child process
reads that with the readers of ``unghost push`` and writes the response next to it
(`write_response`). The files are untrusted, so the child has limits on memory and time
(`app.engine.children`).
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from app.errors import TooLarge
from app.ingest.tar import Member
from filter_core.errors import FilterError, LayoutError
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
)
from filter_core.formats.registry import (
    FORMATS,
    describe_source,
    layout_format,
    possible_layouts,
    read_source,
)
from filter_core.formats.streams import names_that_tell_nothing
from filter_core.formats.table import TABLE
from unghost.wire.folders import (
    FolderEnd,
    FolderFrame,
    FolderHead,
    UnmatchedFile,
)
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
_DEVICE: Final = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)
"""Names reserved for devices on Windows, with any suffix."""


class SentFolder:
    """A temporary folder with the files that are being received.

    A file that cannot be written there is listed in `refused`; the others are kept.

    Parameters
    ----------
    parent : Path
        Where to create it.
    most_files : int
        Maximum number of files and folders together.
    most_file_bytes : int
        Maximum size of one file, the same as for reading the archive.
    """

    def __init__(self, parent: Path, most_files: int, most_file_bytes: int) -> None:
        self._place = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        self.root = self._place / ROOT
        self.root.mkdir()
        self.response = self._place / "response.jsonl"
        self.refused: list[tuple[str, str]] = []
        self._most_files, self._most_file_bytes = most_files, most_file_bytes
        self._folders: set[str] = {""}
        self._files = 0

    def add(self, member: Member) -> None:
        """Write a file.

        Raises
        ------
        TooLarge
            There are more files and folders than allowed.
        """
        why = _why_not(member.name, self.root)
        if why is None and member.content is None:
            why = f"larger than {self._most_file_bytes} bytes"
        if why is None:
            why = self._write(member.name, member.content or b"")
        if why is not None:
            self.refused.append((member.name, why))
        self._files += 1
        if self._files + len(self._folders) - 1 > self._most_files:
            raise TooLarge(
                f"the folder has more than {self._most_files} files and folders; "
                "unghost push takes any number"
            )

    def _write(self, name: str, content: bytes) -> str | None:
        path = self.root / name
        folder = name.rpartition("/")[0]
        try:
            if folder not in self._folders:
                path.parent.mkdir(parents=True, exist_ok=True)
                self._note(folder)
            with path.open("xb") as file:
                file.write(content)
        except (FileExistsError, NotADirectoryError):
            return "another file has this name, or one that is equal on the server"
        except (OSError, ValueError):
            if shutil.disk_usage(self.root).free < len(content):
                raise
            return "no file can have this name on the server"
        return None

    def _note(self, folder: str) -> None:
        while folder and folder not in self._folders:
            self._folders.add(folder)
            folder = folder.rpartition("/")[0]

    def remove(self) -> None:
        """Delete the folder and the response."""
        shutil.rmtree(self._place, ignore_errors=True)


def _why_not(name: str, root: Path) -> str | None:
    """Why no file of this name may be written; None if it may."""
    # By the rules of this system: on Windows a backslash or a drive leads elsewhere.
    place = os.path.normpath(root / name)
    if "\0" in name or _relative(Path(place), root) != name or name.startswith("../"):
        return "its name leads out of the folder"
    parts = name.split("/")
    if any(map(_DEVICE.match, parts)):
        return "its name is reserved for a device on Windows"
    sizes = [len(part.encode()) for part in parts]
    if max(sizes) > MOST_PART_BYTES or sum(sizes) > MOST_NAME_BYTES:
        return "its name is too long"
    return "it is nested too deep" if len(parts) > MOST_DEPTH else None


@dataclass(frozen=True)
class FolderTask:
    """The arguments of a child process that reads a folder.

    Attributes
    ----------
    root : Path
        The folder with the files.
    response : Path
        The file to write.
    layout : str
        One of `LAYOUTS`, or a plug-in's name; ``auto`` chooses the likeliest.
    refused : tuple of (str, str)
        Files that are not in the folder, each with the reason.
    most_bytes : int
        Maximum size of the response.
    """

    root: Path
    response: Path
    layout: str
    refused: tuple[tuple[str, str], ...]
    most_bytes: int


def write_response(task: FolderTask) -> int:
    """Read a folder and write the response, as lines of JSON.

    Returns
    -------
    int
        The size of the response in bytes.

    Raises
    ------
    LayoutError
        No layout is recognised, or not the requested one; a list of classes cannot be
        read; the response would be too large.
    """
    source = _only_folder(task.root)
    # There are no links here, and `_name_of` refuses every file that was not sent: its
    # message fits the page better than the reader's, which names an option.
    named = {} if task.layout == "auto" else {"layout": task.layout}
    description = describe_source(source, options={"outside_files": None, **named})
    layouts = possible_layouts(source)
    layout = task.layout if task.layout != "auto" else description.own_layout
    if layout == "auto" and layouts:
        layout = layouts[0]
    found = read_source(source, layout, description)
    layouts = layouts or (found.layout,)
    settings = description.segmentation_settings()
    with _Response(task, source) as response:
        response.write(
            FolderHead.model_validate(
                {
                    "layout": found.layout,
                    "layouts": layouts,
                    "titles": {
                        name: layout_format(name).title
                        for name in (*layouts, found.layout)
                    },
                    "classes": found.classes,
                    "settings": settings,
                    "config": {
                        name: value
                        for name, value in description.config_keys().items()
                        if name not in settings
                    },
                    "count": found.count,
                }
            )
        )
        response.write_frames(found)
        response.write_unmatched(found)
        response.write(
            FolderEnd(
                end=True,
                frames=response.frames,
                faulty=response.faulty,
                unmatched=response.unmatched,
                notes=[*found.notes(), *response.notes(found.layout)],
            )
        )
        return response.size


def _only_folder(root: Path) -> Path:
    """The only folder in `root`, if there is nothing else there; otherwise `root`."""
    visible = [path for path in root.iterdir() if not is_hidden(path.name)]
    only = visible[0] if len(visible) == 1 else root
    return only if only.is_dir() else root


@dataclass
class _Response:
    """Writes the lines of the response, and counts them."""

    task: FolderTask
    source: Path
    frames: int = 0
    faulty: int = 0
    unmatched: int = 0
    size: int = 0
    used: set[str] = field(default_factory=set)
    images: set[str] = field(default_factory=set)

    def __enter__(self) -> _Response:
        self._file = self.task.response.open("wb")
        self._names = {
            _relative(Path(folder, name), self.task.root)
            for folder, _, files in os.walk(self.task.root)
            for name in files
        }
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def write(self, line: ResponseModel) -> None:
        self._write(_line(line))

    def _write(self, line: bytes) -> None:
        self.size += len(line) + 1
        if self.size > self.task.most_bytes:
            raise LayoutError(
                f"the description of this folder is larger than {self.task.most_bytes} "
                "bytes; unghost push takes folders of any size"
            )
        self._file.write(line + b"\n")

    def write_frames(self, found: FrameSet) -> None:
        for source in found:
            self.frames += 1
            try:
                line = self._frame(source)
            except LayoutError as fault:
                self.faulty += 1
                line = _faulty(source.key, fault)
            self._write(line)

    def _frame(self, source: FrameSource) -> bytes:
        if problem := source.problem or missing_image(source):
            raise _as_layout_error(problem)
        given = {"image": source.image, "segmentation": source.segmentation}
        given |= source.others
        files = {
            kind: self._name_of(kind, path)
            for kind, path in given.items()
            if path is not None
        }
        self.used.update(files.values())
        if source.image is not None:
            self.images.add(_relative(source.image, self.source))
        return _line(
            FolderFrame(
                key=source.key,
                annotation=source.annotation,
                annotation_text=_text_of(source.annotation),
                files=files,
                fault=None,
            )
        )

    def _name_of(self, kind: str, path: Path) -> str:
        """The name of a sent file; a manifest may name files that were not sent."""
        name = _relative(path, self.task.root)
        if name in self._names:
            return name
        inside = path.is_relative_to(self.source)
        shown = path.relative_to(self.source) if inside else path
        raise LayoutError(f"{kind}: {shown} is not among these files")

    def notes(self, layout: str) -> Iterator[str]:
        """What reading with pixels, which were not sent, could find out."""
        silent = names_that_tell_nothing(sorted(self.images))
        if silent and layout != MANIFEST.name:
            yield (
                "only the names of files told pictures from segmentations, and some "
                f"say neither, such as {silent[0]}; the command line looks at the "
                "pixels, too"
            )

    def write_unmatched(self, found: FrameSet) -> None:
        listed = [(one.path, one.why) for one in found.unmatched]
        strange = self._strange(found.layout, {path for path, _ in listed})
        for path, why in (*self.task.refused, *listed, *strange):
            self.unmatched += 1
            self.write(UnmatchedFile(path=path, why=why))

    def _strange(self, layout: str, listed: set[str]) -> Iterator[tuple[str, str]]:
        """Files that belong to no frame, and that no reader of the layout opens."""
        # A plug-in may open any text.
        has_notes = layout in FORMATS and layout != TABLE.name
        own = NOTES_SUFFIXES if has_notes else TEXT_SUFFIXES
        manifest = manifest_of(self.source) if layout == MANIFEST.name else None
        known = {
            *self.used,
            *([_relative(manifest, self.task.root)] if manifest else []),
            _relative(self.source / RECORDING_NAME, self.task.root),
        }
        top = _relative(self.source, self.task.root)
        for name in sorted(self._names - known):
            if any(map(is_hidden, name.split("/"))):
                continue
            shown = name if top == "." else name[len(top) + 1 :]
            if manifest is not None:
                yield shown, "no line of the manifest names it"
            elif shown not in listed and not name.lower().endswith(
                (*IMAGE_SUFFIXES, *own)
            ):
                yield shown, "neither an image nor a label"


def _relative(path: Path, root: Path) -> str:
    return os.path.relpath(path, root).replace(os.sep, "/")


def _as_layout_error(problem: FilterError) -> LayoutError:
    return LayoutError(problem.detail, pointer=problem.pointer, code=problem.kind)


def _faulty(key: str, fault: LayoutError) -> bytes:
    told = Fault(pointer=fault.pointer, code=fault.kind, detail=fault.detail)
    frame = FolderFrame(
        key=key, annotation=None, annotation_text=None, files={}, fault=told
    )
    return _line(frame)


_LONG_INTEGER: Final = re.compile(r"(?<![\d.])\d{16,}(?![\d.eE])")
"""A whole number in JSON that may be beyond 2^53; also in a text."""


def _text_of(annotation: Mapping[str, object] | None) -> str | None:
    """The annotation as JSON, if the page could not give it back with all digits."""
    text = json.dumps(annotation)
    return text if _LONG_INTEGER.search(text) else None


def _line(line: ResponseModel) -> bytes:
    try:
        # ASCII: a key can have lone surrogates, which UTF-8 cannot encode.
        return json.dumps(line.model_dump(), allow_nan=False).encode()
    except ValueError as exc:
        # JSON has neither NaN nor infinity, but 1e999 is read as one.
        raise LayoutError(
            "expected finite numbers in the annotation, found one that is NaN or too "
            "large"
        ) from exc
