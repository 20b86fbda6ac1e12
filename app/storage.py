"""Blobs: files named by their content, durable before anything refers to them."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

_PREFIX_LENGTH: Final = 2
"""Characters of the digest that name the sub-folder: 256 of them."""


def sha256_of(data: bytes) -> str:
    """The name of a blob."""
    return hashlib.sha256(data).hexdigest()


class FolderStorage:
    """Blobs in a folder; safe for several writers, readable by any tool."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def put(self, blobs: Mapping[str, bytes]) -> None:
        """Store blobs by their digests; when this returns they survive a power cut.

        Each file is written beside its place, flushed, and renamed; each folder is
        flushed once. A blob that is there already costs nothing.
        """
        folders = set()
        for digest, data in blobs.items():
            path = self.path(digest)
            if not path.exists():
                folders.add(self._write(path, data))
        for folder in folders:
            _flush_folder(folder)

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
        self._make_folder(path.parent)
        file.replace(path)
        _flush_folder(path.parent)
        return name

    def temporary_folder(self) -> Path:
        """A folder on the same file system for files that are being written."""
        folder = self._folder / "tmp"
        folder.mkdir(exist_ok=True)
        return folder

    def _write(self, path: Path, data: bytes) -> Path:
        self._make_folder(path.parent)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".new-")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
        return path.parent

    def _make_folder(self, folder: Path) -> None:
        if not folder.exists():
            folder.mkdir(exist_ok=True)
            _flush_folder(self._folder)


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
