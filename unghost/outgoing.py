"""A frame on its way to the server, and what became of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, TypeAlias

from unghost.errors import ApiError
from unghost.results import Counts

FileContent: TypeAlias = bytes | str | PathLike[str]
Word: TypeAlias = Literal["stored", "already_there", "refused"]

FILE_NAMES: Final = (
    "image",
    "segmentation",
    "depth",
    "instances",
    "lidar",
    "radar",
    "ignore_mask",
)
_CHUNK_BYTES: Final = 1 << 18


@dataclass(frozen=True)
class OutgoingFrame:
    """A frame to be sent: its key, its annotation, and its files (paths or bytes)."""

    key: str
    annotation: Mapping[str, Any]
    files: Mapping[str, FileContent] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.files:
            checked_file_name(name)

    def digest(self) -> str:
        """Names the content, as the server's guide to the API defines it.

        Raises
        ------
        OSError
            A file cannot be read.
        """
        lines = [b"frame 1"]
        for name, content in sorted(self.files.items()):
            lines.append(f"{name} {_sha256(content)}".encode())
        digest = hashlib.sha256(b"\n".join([*lines, canonical_json(self.annotation)]))
        return digest.hexdigest()


@dataclass(frozen=True)
class Sent:
    """A frame that was sent, and that the server has; `counts` are its boxes'."""

    key: str
    frame_id: int
    created: bool
    counts: Counts

    @property
    def word(self) -> Word:
        """What happened, in a word."""
        return "stored" if self.created else "already_there"


@dataclass(frozen=True)
class AlreadyThere:
    """A frame that was not sent, because the server has the very same one."""

    key: str
    frame_id: int
    word: ClassVar[Word] = "already_there"


@dataclass(frozen=True)
class NotSent:
    """A frame that the server refused, or that cannot be read here."""

    key: str
    error: ApiError | OSError | ValueError
    word: ClassVar[Word] = "refused"


Outcome: TypeAlias = Sent | AlreadyThere | NotSent


def canonical_json(annotation: Mapping[str, Any]) -> bytes:
    """The one way to write an annotation of this meaning."""
    return json.dumps(annotation, sort_keys=True, separators=(",", ":")).encode()


def checked_file_name(name: str) -> str:
    """The name of a frame's file; TypeError if there is no such file."""
    if name not in FILE_NAMES:
        raise TypeError(f"{name!r} is not a file of a frame: {', '.join(FILE_NAMES)}")
    return name


def is_text(key: str) -> bool:
    """Whether a key can be sent; the name of a file may be bytes that are no text."""
    try:
        key.encode()
    except UnicodeEncodeError:
        return False
    return True


def _sha256(content: FileContent) -> str:
    if isinstance(content, bytes):
        return hashlib.sha256(content).hexdigest()
    digest = hashlib.sha256()
    with Path(content).open("rb", buffering=0) as file:
        while chunk := file.read(_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()
