"""A folder that was dropped: which frames its files would be. Nothing is stored.

The files come as a tar: text files as they are, pictures and other files without their
content, since readers of folders go by names. They are laid into a folder of their own
(`SentFolder`), and a child process reads it with the readers that ``unghost push`` uses
and writes the response beside it (`write_response`). Strangers chose these files, so
the child has a limit of memory and time (`app.engine.children`).
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from app.errors import TooLarge
from app.ingest.tar import Member
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.manifest import MANIFEST, manifest_of
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    FrameSet,
    FrameSource,
    is_hidden,
)
from filter_core.formats.registry import possible_layouts, read_source
from unghost.wire.folders import (
    FolderEnd,
    FolderFrame,
    FolderHead,
    UnmatchedFile,
)
from unghost.wire.model import Fault, ResponseModel

PREFIX: Final = "folder-"
"""Of the names of folders that hold what was sent, and the response."""
ROOT: Final = "these files"
"""The name of the folder, as errors call it where what was sent has none."""
MOST_NAME_BYTES: Final = 1024
"""Of the name of one file with its folders."""
MOST_PART_BYTES: Final = 255
"""Of the name alone, or of that of one folder: file systems take no more."""
MOST_DEPTH: Final = 32
"""Folders inside of each other."""
MOST_LONGER: Final = 4
"""The response on a folder may be so many times as long as the folder."""
_TEXTS: Final = (".txt", ".xml", ".json", ".jsonl", ".yaml", ".yml", ".names")
"""What readers look into; which of them each reader does is not known here."""
_DEVICE: Final = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)
"""Names that Windows gives to devices, whatever follows the first dot."""


class SentFolder:
    """The files of a folder as they come, on the disk until it is removed.

    A file that cannot be laid there is noted in `refused`; the others go on.

    Parameters
    ----------
    parent : Path
        The folder to make it in.
    most_files : int
        Files and folders together.
    most_file_bytes : int
        Of one file, as the archive was read with.
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
        """Lay a file there.

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
            return "another file has this name, or one that the server takes for it"
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
        """Remove everything, from the disk too."""
        shutil.rmtree(self._place, ignore_errors=True)


def _why_not(name: str, root: Path) -> str | None:
    """Why no file of this name is laid anywhere; None if there is no reason."""
    # The rules of this system: elsewhere a backslash or a drive leads away.
    place = os.path.normpath(root / name)
    if "\0" in name or _relative(Path(place), root) != name or name.startswith("../"):
        return "its name leads out of the folder"
    parts = name.split("/")
    if any(map(_DEVICE.match, parts)):
        return "its name is that of a device on Windows"
    sizes = [len(part.encode()) for part in parts]
    if max(sizes) > MOST_PART_BYTES or sum(sizes) > MOST_NAME_BYTES:
        return "its name is too long"
    return "it lies too deep" if len(parts) > MOST_DEPTH else None


@dataclass(frozen=True)
class FolderTask:
    """What a child process is asked.

    Attributes
    ----------
    root : Path
        The folder with the files.
    response : Path
        The file to write.
    layout : str
        One of `LAYOUTS`; ``auto`` takes the likeliest.
    refused : tuple of (str, str)
        Files that are not in the folder, each with the reason.
    most_bytes : int
        Of the response.
    """

    root: Path
    response: Path
    layout: str
    refused: tuple[tuple[str, str], ...]
    most_bytes: int


def write_response(task: FolderTask) -> int:
    """Read a folder and write what is found, a line of JSON for each thing.

    Returns
    -------
    int
        The bytes of the response.

    Raises
    ------
    LayoutError
        No layout is recognised, or not the one that was named; a list of classes cannot
        be read; the response would be too long.
    """
    source = _only_folder(task.root)
    layouts = possible_layouts(source)
    layout = task.layout
    if layout == "auto" and layouts:
        layout = layouts[0]
    found = read_source(source, layout)
    with _Response(task, source) as response:
        response.write(
            FolderHead.model_validate(
                {
                    "layout": found.layout,
                    "layouts": layouts or (found.layout,),
                    "classes": found.classes,
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
            )
        )
        return response.size


def _only_folder(root: Path) -> Path:
    """The one folder that was dropped, if there is nothing beside it; else all."""
    visible = [path for path in root.iterdir() if not is_hidden(path.name)]
    only = visible[0] if len(visible) == 1 else root
    return only if only.is_dir() else root


@dataclass
class _Response:
    """The lines of the response, and what was counted on the way."""

    task: FolderTask
    source: Path
    frames: int = 0
    faulty: int = 0
    unmatched: int = 0
    size: int = 0
    used: set[str] = field(default_factory=set)

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
                f"what is in this folder takes more than {self.task.most_bytes} bytes "
                "to say; unghost push takes folders of any size"
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
        if source.problem is not None:
            raise _as_layout_error(source.problem)
        given = {"image": source.image, "segmentation": source.segmentation}
        given |= source.others
        files = {
            kind: self._name_of(kind, path)
            for kind, path in given.items()
            if path is not None
        }
        self.used.update(files.values())
        return _line(
            FolderFrame(
                key=source.key,
                annotation=source.annotation,
                files=files,
                fault=None,
            )
        )

    def _name_of(self, kind: str, path: Path) -> str:
        """The name that a file was sent under; only a manifest names any other."""
        name = _relative(path, self.task.root)
        if name in self._names:
            return name
        inside = path.is_relative_to(self.source)
        shown = path.relative_to(self.source) if inside else path
        raise LayoutError(f"{kind}: {shown} is not among these files")

    def write_unmatched(self, found: FrameSet) -> None:
        listed = [(one.path, one.why) for one in found.unmatched]
        for path, why in (*self.task.refused, *listed, *self._strange(found.layout)):
            self.unmatched += 1
            self.write(UnmatchedFile(path=path, why=why))

    def _strange(self, layout: str) -> Iterator[tuple[str, str]]:
        """Files that no frame has, and that no reader looks at either."""
        manifest = manifest_of(self.source) if layout == MANIFEST.name else None
        known = {
            *self.used,
            *([_relative(manifest, self.task.root)] if manifest else []),
        }
        top = _relative(self.source, self.task.root)
        for name in sorted(self._names - known):
            if any(map(is_hidden, name.split("/"))):
                continue
            shown = name if top == "." else name[len(top) + 1 :]
            if manifest is not None:
                yield shown, "no line of the manifest names it"
            elif not name.lower().endswith((*IMAGE_SUFFIXES, *_TEXTS)):
                yield shown, "neither an image nor a label"


def _relative(path: Path, root: Path) -> str:
    return os.path.relpath(path, root).replace(os.sep, "/")


def _as_layout_error(problem: FilterError) -> LayoutError:
    return LayoutError(problem.detail, pointer=problem.pointer, code=problem.kind)


def _faulty(key: str, fault: LayoutError) -> bytes:
    told = Fault(pointer=fault.pointer, code=fault.kind, detail=fault.detail)
    return _line(FolderFrame(key=key, annotation=None, files={}, fault=told))


def _line(line: ResponseModel) -> bytes:
    try:
        # ASCII: a key can have halves of surrogate pairs, which UTF-8 cannot.
        return json.dumps(line.model_dump(), allow_nan=False).encode()
    except ValueError as exc:
        # JSON has no infinite number, but 1e999 in it is read as one.
        raise LayoutError("a number in the annotation is too large") from exc
