"""A frame to be sent, its encodings for the request, and its outcome.

A single frame is sent as a multipart form, many frames as members of a tar archive.
This module encodes them; `push` and `batches` send them.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO, FileIO
from os import PathLike
from pathlib import Path
from typing import (
    IO,
    TYPE_CHECKING,
    ClassVar,
    Final,
    Protocol,
    TypeAlias,
    get_args,
    runtime_checkable,
)

from unghost.client.call import Files
from unghost.client.errors import ApiError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from unghost.wire.datasets import VerdictCounts
    from unghost.wire.model import Json
    from unghost.wire.words import UploadWord


@runtime_checkable
class Array(Protocol):
    """An array of numpy, which is not imported here."""

    @property
    def shape(self) -> tuple[int, ...]: ...
    @property
    def dtype(self) -> object: ...


@runtime_checkable
class Picture(Protocol):
    """An image of PIL, which is not imported here."""

    def save(self, fp: IO[bytes], format: str | None = None) -> None: ...


FileContent: TypeAlias = bytes | str | PathLike[str] | Array | Picture
"""A frame's file: its bytes, its path, an array of numpy, or an image of PIL."""

_Content: TypeAlias = bytes | str | PathLike[str]

# The server recognises types by content, so no type is guessed here.
_ANY_TYPE: Final = "application/octet-stream"

_READ_BYTES: Final = 1 << 18

_BLOCK: Final = 512

END_OF_ARCHIVE: Final = bytes(2 * _BLOCK)
"""Two empty blocks, which end a tar archive."""


@dataclass(frozen=True)
class OutgoingFrame:
    """A frame to be sent: its key, its annotation, and its files (paths or bytes).

    The annotation may contain numpy's numbers and arrays. A file may also be an image
    of PIL or an array: (H, W) or (H, W, 3 or 4) of uint8 in the order RGB(A), or (H, W)
    of uint16, which become PNG; depth may also be metres. Others (points) are
    sent as .npy.
    """

    key: str
    annotation: Json
    files: Mapping[str, FileContent] = field(default_factory=dict)
    _contents: Mapping[str, _Content] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not isinstance(self.annotation, Mapping):
            raise TypeError(
                f"frame {self.key!r}: expected a mapping as annotation, found "
                f"{type(self.annotation).__name__}"
            )
        contents = {
            checked_file_name(name): _encoded(name, content)
            for name, content in self.files.items()
        }
        object.__setattr__(self, "_contents", contents)

    def digest(self) -> str:
        """Digest of the content, as defined in docs/api.md.

        Raises OSError if a file cannot be read, and ValueError if the annotation cannot
        be written as JSON.
        """
        lines = [b"frame 1"]
        for name, content in sorted(self._contents.items()):
            lines.append(f"{name} {_sha256(content)}".encode())
        digest = hashlib.sha256(b"\n".join([*lines, canonical_json(self.annotation)]))
        return digest.hexdigest()

    def form(self) -> Files:
        """The parts of a form: the annotation and the files, read into memory.

        Raises OSError if a file cannot be read, and ValueError as `digest` does.
        """
        annotation = canonical_json(self.annotation)
        form = {"annotation": ("annotation.json", annotation, "application/json")}
        for name, content in self._contents.items():
            form[name] = (name, _bytes(content), _ANY_TYPE)
        return form

    def packed(self, name: str) -> PackedFrame:
        """The members of an archive; of the files only the sizes are read.

        `name` is the common beginning of the members' names, which groups them.

        Raises OSError if a file does not exist, is not a regular file, or may not be
        read, and ValueError if the key is not text, or the annotation cannot be written
        as JSON.
        """
        if not is_text(self.key):
            raise ValueError("the key is not text: its file's name is not UTF-8")
        annotation = canonical_json({**self.annotation, "key": self.key})
        pieces = list(_member(f"{name}.json", annotation))
        for kind, content in self._contents.items():
            pieces.extend(_member(f"{name}.{kind}", _piece(content)))
        joined = tuple(_joined(pieces))
        return PackedFrame(self, name, joined, sum(map(size_of, joined)))


@dataclass(frozen=True)
class FilePiece:
    """A whole file, with its size when the archive's length was announced."""

    path: Path
    size: int


Piece: TypeAlias = bytes | FilePiece
"""A part of an archive: in memory, or still on the disk."""


@dataclass(frozen=True, eq=False)
class PackedFrame:
    """A frame as members of an archive: the annotation first, then the files.

    `name` is the common beginning of the members' names, `size` the bytes of all
    pieces.
    """

    frame: OutgoingFrame
    name: str
    pieces: tuple[Piece, ...]
    size: int


@dataclass(frozen=True)
class Sent:
    """A frame that was sent and stored; `counts` are the verdicts of its boxes.

    `answers_set_aside` counts people's answers on the frame that it replaced which were
    not carried over, and `boxes_set_aside` are ids of the first of their boxes. `notes`
    say how its depth and instance image were read.
    """

    key: str
    frame_id: int
    created: bool
    counts: VerdictCounts
    answers_set_aside: int = 0
    boxes_set_aside: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def word(self) -> UploadWord:
        """The outcome in one word."""
        return "stored" if self.created else "already_there"


@dataclass(frozen=True)
class AlreadyThere:
    """A frame that was not sent, because the server already has the same content."""

    key: str
    frame_id: int
    word: ClassVar[UploadWord] = "already_there"


@dataclass(frozen=True)
class NotSent:
    """A frame that the server refused, or that cannot be read here."""

    key: str
    error: ApiError | OSError | ValueError
    word: ClassVar[UploadWord] = "refused"


Outcome: TypeAlias = Sent | AlreadyThere | NotSent
"""The outcome of a frame."""


def _encoded(name: str, content: FileContent) -> _Content:
    """A file as bytes or its path; arrays and images of PIL are encoded."""
    if isinstance(content, bytes | str | PathLike):
        return content
    written = BytesIO()
    if isinstance(content, Picture):
        content.save(written, format="PNG")
        return written.getvalue()
    if not isinstance(content, Array):
        raise TypeError(
            f"{name}: expected bytes, a path, an array or an image of PIL, found "
            f"{type(content).__name__}"
        )
    import numpy as np  # the array is numpy's: it is loaded already

    array = np.asarray(content)
    if name in _PICTURES and array.dtype in (np.uint8, np.uint16, np.bool_):
        return _png(name, array)
    if name == "depth":  # as CARLA's camera writes it, in 24 bits
        code = np.rint(array.clip(0, _FARTHEST) * ((2**24 - 1) / _FARTHEST))
        parts = code.astype("<u4").view(np.uint8).reshape(*array.shape, 4)
        return _png(name, parts[..., :3])
    np.save(written, array, allow_pickle=False)
    return written.getvalue()


_FARTHEST: Final = 1000.0
"""Metres at which CARLA's depth ends."""
_PICTURES: Final = ("image", "segmentation", "depth", "instances", "ignore_mask")
_COLOURS: Final = {1: 0, 3: 2, 4: 6}
"""PNG's colour type by the number of channels: grey, RGB, RGBA."""


def _png(name: str, array: NDArray[np.generic]) -> bytes:
    """An array of uint8, uint16 or bool as PNG, in the order of its channels."""
    channels = array.shape[2] if array.ndim == 3 else 1
    if array.ndim not in (2, 3) or channels not in _COLOURS or not array.size:
        raise ValueError(
            f"{name}: expected an array of (H, W), (H, W, 3) or (H, W, 4), found "
            f"{array.shape}"
        )
    height, width = array.shape[:2]
    bits = 8 * array.itemsize
    pixels = array.astype(">u2" if bits == 16 else "u1").tobytes()
    if array.dtype.kind == "b":
        pixels = pixels.replace(b"\1", b"\xff")
    row = len(pixels) // height
    lines = b"".join(b"\0" + pixels[at : at + row] for at in range(0, len(pixels), row))
    head = struct.pack(">IIBBBBB", width, height, bits, _COLOURS[channels], 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(lines, 1)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body))
        + kind
        + body
        + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )


def canonical_json(annotation: Json) -> bytes:
    """The annotation as canonical JSON: equal annotations give equal text.

    Raises ValueError if it has a value that JSON does not have.
    """
    try:
        text = json.dumps(
            dict(annotation), sort_keys=True, separators=(",", ":"), default=_plain
        )
    except (TypeError, RecursionError) as error:
        raise ValueError(
            f"the annotation cannot be written as JSON: {error}"
        ) from error
    return text.encode()


def _plain(value: object) -> object:
    """The numbers of an array or of one of numpy's numbers, without importing numpy."""
    if isinstance(value, Mapping):
        return dict(value)
    as_numbers = getattr(value, "tolist", None)
    if as_numbers is None:
        raise TypeError(f"found a value of type {type(value).__name__}")
    return as_numbers()


def checked_file_name(name: str) -> str:
    """The name of a frame's file; TypeError if there is no such file."""
    from unghost.wire.words import FileKind  # rarely needed

    kinds = get_args(FileKind)
    if name not in kinds:
        raise TypeError(f"{name!r} is not a file of a frame: {', '.join(kinds)}")
    return name


def is_text(key: str) -> bool:
    """Whether a key is valid text; a file name need not be valid UTF-8."""
    try:
        key.encode()
    except UnicodeEncodeError:
        return False
    return True


def size_of(piece: Piece) -> int:
    """Bytes of a piece."""
    return piece.size if isinstance(piece, FilePiece) else len(piece)


def open_regular(path: Path) -> FileIO:
    """Open a file to read it, unbuffered, without waiting for the writer of a pipe.

    Raises OSError if it cannot be opened, or is not a regular file.
    """
    no_wait = getattr(os, "O_NONBLOCK", 0)
    file = FileIO(path, opener=lambda name, flags: os.open(name, flags | no_wait))
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return file


def _bytes(content: _Content) -> bytes:
    if isinstance(content, bytes):
        return content
    with open_regular(Path(content)) as file:
        return file.readall()


def _sha256(content: _Content) -> str:
    if isinstance(content, bytes):
        return hashlib.sha256(content).hexdigest()
    digest = hashlib.sha256()
    with open_regular(Path(content)) as file:
        while chunk := file.read(_READ_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def _piece(content: _Content) -> Piece:
    if isinstance(content, bytes):
        return content
    path = Path(content)
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise IsADirectoryError(f"{path.name} is not a file")
    if not os.access(path, os.R_OK):
        raise PermissionError(f"{path.name} cannot be read: permission denied")
    return FilePiece(path, status.st_size)


def _member(name: str, content: Piece) -> Iterator[Piece]:
    import tarfile  # only archives need it

    member = tarfile.TarInfo(name)
    member.size = size_of(content)
    yield member.tobuf(tarfile.USTAR_FORMAT)
    yield content
    yield bytes(-member.size % _BLOCK)


def _joined(pieces: Iterable[Piece]) -> Iterator[Piece]:
    """The same bytes in fewer pieces: adjacent pieces in memory are joined."""
    held: list[bytes] = []
    for piece in pieces:
        if isinstance(piece, bytes):
            held.append(piece)
        else:
            yield b"".join(held)
            yield piece
            held = []
    yield b"".join(held)
