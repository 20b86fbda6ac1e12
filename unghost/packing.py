"""Frames as pieces of a tar archive: what is in memory, and files still on the disk."""

from __future__ import annotations

import os
import stat
import tarfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

from unghost.outgoing import FileContent, OutgoingFrame, canonical_json, is_text

_BLOCK: Final = 512
END_OF_ARCHIVE: Final = bytes(2 * _BLOCK)


@dataclass(frozen=True)
class FilePiece:
    """All of a file, which had this size when the archive's length was said."""

    path: Path
    size: int


Piece: TypeAlias = bytes | FilePiece


@dataclass(frozen=True, eq=False)
class PackedFrame:
    """A frame as members of an archive; `name` is what ties them together there."""

    frame: OutgoingFrame
    name: str
    pieces: tuple[Piece, ...]
    size: int


def pack(frame: OutgoingFrame, name: str) -> PackedFrame:
    """The annotation first, then the files; nothing is read but their sizes.

    Raises
    ------
    OSError
        A file is not there, is none, or may not be read.
    ValueError
        The key is not text.
    """
    if not is_text(frame.key):
        raise ValueError("the key is not text: its file's name is not UTF-8")
    annotation = canonical_json({**frame.annotation, "key": frame.key})
    pieces = list(_member(f"{name}.json", annotation))
    for kind, content in frame.files.items():
        pieces.extend(_member(f"{name}.{kind}", _content(content)))
    joined = tuple(_joined(pieces))
    return PackedFrame(frame, name, joined, sum(map(size_of, joined)))


def size_of(piece: Piece) -> int:
    """Bytes of a piece."""
    return piece.size if isinstance(piece, FilePiece) else len(piece)


def _content(content: FileContent) -> Piece:
    if isinstance(content, bytes):
        return content
    path = Path(content)
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise IsADirectoryError(f"{path.name} is not a file")
    if not os.access(path, os.R_OK):
        raise PermissionError(f"{path.name} may not be read")
    return FilePiece(path, found.st_size)


def _member(name: str, content: Piece) -> Iterator[Piece]:
    member = tarfile.TarInfo(name)
    member.size = size_of(content)
    yield member.tobuf(tarfile.USTAR_FORMAT)
    yield content
    yield bytes(-member.size % _BLOCK)


def _joined(pieces: Iterable[Piece]) -> Iterator[Piece]:
    """What is in memory between two files, as one piece: each is sent by itself."""
    held: list[bytes] = []
    for piece in pieces:
        if isinstance(piece, bytes):
            held.append(piece)
        else:
            yield b"".join(held)
            yield piece
            held = []
    yield b"".join(held)
