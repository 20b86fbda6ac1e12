"""Blobs: files named by their content, durable before anything refers to them."""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

_PREFIX_LENGTH: Final = 2
"""Characters of the digest that name the sub-folder: 256 of them."""
_NEW_FILE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)


def sha256_of(data: bytes) -> str:
    """The name of a blob."""
    return hashlib.sha256(data).hexdigest()


@dataclass(frozen=True)
class Drafts:
    """Blobs of which the new ones are written, but not durable and not in place."""

    places: list[Path]
    files: list[tuple[Path, Path]] = field(default_factory=list)


class FolderStorage:
    """Blobs in a folder; safe for several writers, readable by any tool."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._make_folders()

    def put(self, blobs: Mapping[str, bytes]) -> None:
        """Store blobs by their digests; when this returns they survive a power cut.

        A blob that is there already is not written again; its folder is flushed all
        the same, as whoever wrote it may not have come to that yet.
        """
        self.settle([self.draft(blobs)])

    def draft(self, blobs: Mapping[str, bytes]) -> Drafts:
        """Write blobs beside their places; `settle` or `discard` them afterwards."""
        drafts = Drafts([self.path(digest) for digest in blobs])
        try:
            for path, data in zip(drafts.places, blobs.values(), strict=True):
                if not path.exists():
                    drafts.files.append((self._write(path, data), path))
        except BaseException:
            self.discard([drafts])
            raise
        return drafts

    def settle(self, many: Sequence[Drafts]) -> None:
        """Make drafts durable blobs: each file and each folder is flushed once.

        Files before folders, and all of them in a row: what one flush has carried to
        the disk of its neighbours, the next ones need not.
        """
        try:
            for draft, _ in _files(many):
                _flush(draft)
            for draft, path in _files(many):
                draft.replace(path)
        except BaseException:
            self.discard(many)
            raise
        for folder in {path.parent for drafts in many for path in drafts.places}:
            _flush_folder(folder)

    def discard(self, many: Sequence[Drafts]) -> None:
        """Take drafts away that nobody wants any more."""
        for draft, _ in _files(many):
            draft.unlink(missing_ok=True)

    def path(self, digest: str) -> Path:
        """Where a blob lies; the name comes from its digest alone."""
        if len(digest) != 64 or not set(digest) <= set("0123456789abcdef"):
            raise ValueError(f"not a SHA-256 digest: {digest!r}")
        return self._folder / digest[:_PREFIX_LENGTH] / digest

    def read(self, digest: str) -> bytes:
        """A blob's bytes."""
        return self.path(digest).read_bytes()

    def adopt(self, file: Path) -> str:
        """Move a finished file of the same file system into the store."""
        digest = hashlib.sha256()
        with file.open("rb") as stream:
            while chunk := stream.read(1 << 20):
                digest.update(chunk)
            os.fsync(stream.fileno())
        name = digest.hexdigest()
        path = self.path(name)
        file.replace(path)
        _flush_folder(path.parent)
        return name

    def temporary_folder(self) -> Path:
        """A folder on the same file system for files that are being written."""
        folder = self._folder / "tmp"
        folder.mkdir(exist_ok=True)
        return folder

    def _write(self, path: Path, data: bytes) -> Path:
        draft = path.with_name(f".new-{secrets.token_hex(8)}")
        try:
            descriptor = os.open(draft, _NEW_FILE, 0o600)
        except FileNotFoundError:  # somebody emptied the folder while we run
            self._make_folders()
            descriptor = os.open(draft, _NEW_FILE, 0o600)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
        return draft

    def _make_folders(self) -> None:
        # All of them now: later, a blob could find a folder that another writer has
        # made and not yet flushed, and would have to wait for two.
        for number in range(16**_PREFIX_LENGTH):
            name = f"{number:0{_PREFIX_LENGTH}x}"
            (self._folder / name).mkdir(parents=True, exist_ok=True)
        _flush_folder(self._folder)


def _files(many: Sequence[Drafts]) -> list[tuple[Path, Path]]:
    return [one for drafts in many for one in drafts.files]


def _flush(file: Path) -> None:
    descriptor = os.open(file, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flush_folder(folder: Path) -> None:
    # A rename is only durable once its folder is. Windows cannot open folders, and
    # does not need to.
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
