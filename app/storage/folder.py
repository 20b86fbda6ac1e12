"""A folder of blobs: putting them there, reading them, taking them away."""

from __future__ import annotations

import os
import secrets
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

from app.errors import DamagedFile, TryLater
from app.storage.base import (
    Blob,
    Drafts,
    StoredFile,
    digest_of,
    leftovers,
    place_of,
    sha256_of,
    stored_files,
)
from app.storage.durable import flush_file, flush_folder, make_folder

_PREFIX_LENGTH: Final = 2
"""Characters of the digest that name the sub-folder: 256 of them."""
_NEW_FILE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)


@dataclass(frozen=True)
class FolderDrafts(Drafts):
    """Blobs of which the new ones are written, but not durable and not in place."""

    places: list[Path]
    files: list[tuple[Path, Path]] = field(default_factory=list)


class FolderStorage:
    """Blobs in a folder; safe for several writers, readable by any tool."""

    def __init__(self, folder: Path, *, make: bool = True) -> None:
        self.folder = folder
        if make:
            self.prepare()

    def prepare(self) -> None:
        """Make the folder and the 256 in it, where they are not there."""
        # All of them now: later, a blob could find a folder that another writer has
        # made and not yet flushed, and would have to wait for two.
        make_folder(self.folder)
        for number in range(16**_PREFIX_LENGTH):
            name = f"{number:0{_PREFIX_LENGTH}x}"
            (self.folder / name).mkdir(exist_ok=True)
        flush_folder(self.folder)
        flush_folder(self.folder.parent)

    def check(self) -> None:
        """Write a file that nobody sees; OSError if that is not possible."""
        with tempfile.TemporaryFile(dir=self.temporary_folder(), buffering=0) as file:
            file.write(b"ready?")

    def put(self, blobs: Mapping[str, bytes]) -> None:
        """Store blobs by their digests; when this returns they survive a power cut.

        A blob that is there already is not written again; its folder is flushed all
        the same, as whoever wrote it may not have come to that yet.
        """
        self.settle([self.draft(blobs)])

    def draft(self, blobs: Mapping[str, bytes]) -> FolderDrafts:
        """Write blobs beside their places; `settle` or `discard` them afterwards."""
        drafts = FolderDrafts([self.path(digest) for digest in blobs])
        try:
            for path, data in zip(drafts.places, blobs.values(), strict=True):
                if not _holds(path, len(data)):
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
                flush_file(draft)
            for draft, path in _files(many):
                draft.replace(path)
        except BaseException:
            self.discard(many)
            raise
        places = [path for drafts in _own(many) for path in drafts.places]
        for folder in {path.parent for path in places}:
            flush_folder(folder)

    def discard(self, many: Sequence[Drafts]) -> None:
        """Take drafts away that nobody wants any more."""
        for draft, _ in _files(many):
            draft.unlink(missing_ok=True)

    def path(self, digest: str) -> Path:
        """Where a blob lies; the name comes from its digest alone."""
        return self.folder / place_of(digest)

    def read(self, digest: str) -> bytes:
        """A blob's bytes.

        Raises
        ------
        DamagedFile
            It is gone, or not what was stored.
        """
        try:
            content = self.path(digest).read_bytes()
        except FileNotFoundError as exc:
            raise DamagedFile(digest, "is missing") from exc
        if sha256_of(content) != digest:
            raise DamagedFile(digest, "is not what was stored")
        return content

    def whole(self, digest: str, *, size_bytes: int | None) -> Blob:
        """A blob to read from; DamagedFile if it is gone or of another size.

        Its content is not looked at: whoever gets the file can do that.
        """
        path = self.path(digest)
        try:
            found = path.stat().st_size
        except FileNotFoundError as exc:
            raise DamagedFile(digest, "is missing") from exc
        if size_bytes is not None and found != size_bytes:
            raise DamagedFile(digest, f"has {found} of {size_bytes} bytes")
        return Blob(found, partial(_part, path), path)

    def intact(self, digest: str, *, size_bytes: int | None) -> Blob:
        """A blob whose content is what was stored; else DamagedFile."""
        blob = self.whole(digest, size_bytes=size_bytes)
        if digest_of(self.path(digest)) != digest:
            raise DamagedFile(digest, "is not what was stored")
        return blob

    def require(self, digests: Iterable[str]) -> None:
        """Refuse to refer to a blob that somebody took away since it was put.

        Raises
        ------
        TryLater
            One is gone; sent again, it is put again.
        """
        if not all(self.path(digest).exists() for digest in digests):
            raise TryLater("a file was cleared away meanwhile; send the frame again")

    def make_sure(self, digests: Iterable[str]) -> None:
        """As `require`, which is never unsure of files of this machine."""
        self.require(digests)

    def mend(self, blobs: Mapping[str, bytes]) -> None:
        """Put those of stored blobs again that are gone, or of another size."""
        lost = {
            digest: data
            for digest, data in blobs.items()
            if not _holds(self.path(digest), len(data))
        }
        if lost:
            self.put(lost)

    def remove(self, digests: Sequence[str], *, unused_since: float) -> dict[str, int]:
        """Take blobs away but for those put since; sizes of those that were taken."""
        removed = {}
        for digest in digests:
            path = self.path(digest)
            try:
                found = path.stat()
                if found.st_mtime > unused_since:
                    continue
                path.unlink()
            except FileNotFoundError:
                continue
            removed[digest] = found.st_size
        return removed

    def adopt(self, file: Path) -> str:
        """Move a finished file of the same file system into the store."""
        flush_file(file)
        name = digest_of(file)
        path = self.path(name)
        file.replace(path)
        flush_folder(path.parent)
        return name

    def files(self) -> Iterator[StoredFile]:
        """Every blob, folder by folder."""
        return stored_files(self.folder)

    def leftovers(self) -> Iterator[tuple[Path, float]]:
        """Drafts and half exports, each with the time of its last change."""
        return leftovers(self.folder)

    def temporary_folder(self) -> Path:
        """A folder on the same file system for files that are being written."""
        folder = self.folder / "tmp"
        folder.mkdir(exist_ok=True)
        return folder

    def _write(self, path: Path, data: bytes) -> Path:
        draft = path.with_name(f".new-{secrets.token_hex(8)}")
        try:
            descriptor = os.open(draft, _NEW_FILE, 0o600)
        except FileNotFoundError:  # somebody emptied the folder while we run
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
        """Nothing is held."""


def _own(many: Sequence[Drafts]) -> Iterator[FolderDrafts]:
    for drafts in many:
        if not isinstance(drafts, FolderDrafts):
            raise TypeError(f"drafts of another store: {drafts!r}")
        yield drafts


def _files(many: Sequence[Drafts]) -> list[tuple[Path, Path]]:
    return [one for drafts in _own(many) for one in drafts.files]


def _part(path: Path, first: int, end: int) -> bytes:
    with path.open("rb") as file:
        file.seek(first)
        return file.read(end - first)


def _holds(path: Path, size_bytes: int) -> bool:
    """Whether a blob is there and of its size: half of one is written anew.

    From now on it counts as new, so that nobody collects it before its row is there.
    """
    try:
        if path.stat().st_size != size_bytes:
            return False
        with suppress(PermissionError):  # another user's; its row keeps it
            os.utime(path)
    except FileNotFoundError:
        return False
    return True
