"""A blob store in a folder."""

from __future__ import annotations

import os
import secrets
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from app.errors import DamagedFile, TryLater
from app.storage import base
from app.storage.durable import flush_file, flush_folder, make_folder

_PREFIX_LENGTH: Final = 2
"""Characters of the digest that name the sub-folder, of which there are 256."""
_NEW_FILE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)


class FolderDrafts(base.Drafts):
    """Blobs whose new files are written, but neither flushed nor renamed.

    `places` are the paths of all blobs, `files` pairs of a draft and its final path.
    """

    def __init__(self, places: list[Path]) -> None:
        self.places = places
        self.files: list[tuple[Path, Path]] = []


class FolderStorage(base.BlobStore):
    """A `BlobStore` in a folder."""

    def __init__(self, folder: Path, *, make: bool = True) -> None:
        self.folder = folder
        if make:
            self.prepare()

    def prepare(self) -> None:
        """Create the folder and its 256 sub-folders, where they are missing."""
        # All at once: later, a writer could find a sub-folder that another one has
        # created but not flushed, and would have to flush its parent as well.
        make_folder(self.folder)
        for number in range(16**_PREFIX_LENGTH):
            name = f"{number:0{_PREFIX_LENGTH}x}"
            (self.folder / name).mkdir(exist_ok=True)
        flush_folder(self.folder)
        flush_folder(self.folder.parent)

    def check(self) -> None:
        """Write an unnamed file; OSError if that is impossible."""
        with tempfile.TemporaryFile(dir=self.temporary_folder(), buffering=0) as file:
            file.write(b"ready?")

    def draft(self, blobs: Mapping[str, bytes]) -> FolderDrafts:
        """Write blobs next to their final paths; `settle` or `discard` them later.

        A blob that exists already is not written again. Its folder is still flushed:
        another writer may not have done that yet.
        """
        drafts = FolderDrafts([self.path(digest) for digest in blobs])
        try:
            for path, data in zip(drafts.places, blobs.values(), strict=True):
                if not _holds(path, len(data)):
                    drafts.files.append((self._write(path, data), path))
        except BaseException:
            self.discard([drafts])
            raise
        return drafts

    def settle(self, many: Sequence[base.Drafts]) -> None:
        """Make drafts durable blobs: each file and each folder is flushed once.

        All files are flushed before all folders: one flush often writes data of other
        files as well, which makes their own fast.
        """
        try:
            for draft, _ in _files(many):
                flush_file(draft)
            for draft, path in _files(many):
                draft.replace(path)
        except BaseException:
            self.discard(many)
            raise
        places = [path for drafts in _own(many) for path in drafts.places]
        for folder in {path.parent for path in places}:
            flush_folder(folder)

    def discard(self, many: Sequence[base.Drafts]) -> None:
        for draft, _ in _files(many):
            draft.unlink(missing_ok=True)

    def path(self, digest: str) -> Path:
        return self.folder / base.place_of(digest)

    def read(self, digest: str) -> bytes:
        try:
            content = self.path(digest).read_bytes()
        except FileNotFoundError as exc:
            raise DamagedFile(digest, "is missing") from exc
        if base.sha256_of(content) != digest:
            raise DamagedFile(digest, "has changed since it was stored")
        return content

    def open(self, digest: str, *, size_bytes: int | None) -> base.StoredBlob:
        path = self.path(digest)
        try:
            size = path.stat().st_size
        except FileNotFoundError as exc:
            raise DamagedFile(digest, "is missing") from exc
        if size_bytes is not None and size != size_bytes:
            raise DamagedFile(digest, f"has {size} of {size_bytes} bytes")

        def part(first: int, end: int) -> bytes:
            with path.open("rb") as file:
                file.seek(first)
                return file.read(end - first)

        return base.StoredBlob(size, part, path)

    def open_verified(self, digest: str, *, size_bytes: int | None) -> base.StoredBlob:
        blob = self.open(digest, size_bytes=size_bytes)
        if base.digest_of(self.path(digest)) != digest:
            raise DamagedFile(digest, "has changed since it was stored")
        return blob

    def require(self, digests: Iterable[str]) -> None:
        if not all(self.path(digest).exists() for digest in digests):
            raise TryLater("a file was deleted meanwhile; send the frame again")

    def make_sure(self, digests: Iterable[str]) -> None:
        """As `require`, since files on this machine are never uncertain."""
        self.require(digests)

    def put_missing(self, blobs: Mapping[str, bytes]) -> None:
        lost = {
            digest: data
            for digest, data in blobs.items()
            if not _holds(self.path(digest), len(data))
        }
        if lost:
            self.put(lost)

    def remove(self, digests: Sequence[str], *, unused_since: float) -> dict[str, int]:
        removed = {}
        for digest in digests:
            path = self.path(digest)
            try:
                state = path.stat()
                if state.st_mtime > unused_since:
                    continue
                path.unlink()
            except FileNotFoundError:
                continue
            removed[digest] = state.st_size
        return removed

    def adopt(self, file: Path) -> str:
        """Move a file of the same file system into the store; returns its digest."""
        flush_file(file)
        name = base.digest_of(file)
        path = self.path(name)
        file.replace(path)
        flush_folder(path.parent)
        return name

    def files(self) -> Iterator[base.StoredFile]:
        return base.stored_files(self.folder)

    def leftovers(self) -> Iterator[tuple[Path, float]]:
        return base.leftovers(self.folder)

    def temporary_folder(self) -> Path:
        """A folder on the same file system for files that are being written."""
        folder = self.folder / "tmp"
        folder.mkdir(exist_ok=True)
        return folder

    def _write(self, path: Path, data: bytes) -> Path:
        draft = path.with_name(f".new-{secrets.token_hex(8)}")
        try:
            descriptor = os.open(draft, _NEW_FILE, 0o600)
        except FileNotFoundError:  # the sub-folder was deleted meanwhile
            self.prepare()
            descriptor = os.open(draft, _NEW_FILE, 0o600)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
        return draft

    def close(self) -> None:
        """Do nothing: there are no resources to release."""


def _own(many: Sequence[base.Drafts]) -> Iterator[FolderDrafts]:
    for drafts in many:
        if not isinstance(drafts, FolderDrafts):
            raise TypeError(f"drafts of another store: {drafts!r}")
        yield drafts


def _files(many: Sequence[base.Drafts]) -> list[tuple[Path, Path]]:
    return [file for drafts in _own(many) for file in drafts.files]


def _holds(path: Path, size_bytes: int) -> bool:
    """Whether a blob exists with its full size.

    If so, its time is set to now, so that garbage collection keeps it until a row
    refers to it.
    """
    try:
        if path.stat().st_size != size_bytes:
            return False
        with suppress(PermissionError):  # the file of another user
            os.utime(path)
    except FileNotFoundError:
        return False
    return True
