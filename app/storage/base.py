"""The interface of blob stores (a folder or a bucket), and code that they share."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple, Protocol

PIECE: Final = 4 * 1024**2
"""Bytes of a blob that are in memory at a time while it is sent."""


def sha256_of(data: bytes) -> str:
    """The digest of a blob, which is its name."""
    return hashlib.sha256(data).hexdigest()


def place_of(digest: str) -> str:
    """The path of a blob below a store's folder or prefix, made from its digest."""
    if len(digest) != 64 or not set(digest) <= set("0123456789abcdef"):
        raise ValueError(f"not a SHA-256 digest: {digest!r}")
    return f"{digest[:2]}/{digest}"


class Drafts:
    """Blobs that are being put into a store; each store has its own subclass."""


class BlobsUncertain(Exception):
    """Raised if a request to a remote store is needed to find out if blobs exist.

    It rolls back the transaction that would refer to them, since no request should be
    made while others wait to write. Then `BlobStore.make_sure` makes the request, and
    the transaction is retried.
    """

    def __init__(self, digests: Sequence[str]) -> None:
        super().__init__(f"{len(digests)} blobs have to be looked up")
        self.digests = digests


@dataclass(frozen=True)
class StoredBlob:
    """A stored blob, read in parts.

    `part` returns the bytes from the first offset up to the second; `path` is set if
    the blob is a file on this machine.
    """

    size_bytes: int
    part: Callable[[int, int], bytes]
    path: Path | None = None

    def pieces(self, first: int = 0, end: int | None = None) -> Iterator[bytes]:
        """The bytes from `first` up to `end`, a few megabytes at a time."""
        end = self.size_bytes if end is None else end
        for start in range(first, end, PIECE):
            yield self.part(start, min(start + PIECE, end))

    def digest(self) -> str:
        """The digest of the content, which is read in pieces."""
        digest = hashlib.sha256()
        for piece in self.pieces():
            digest.update(piece)
        return digest.hexdigest()


class BlobStore(Protocol):
    """Blobs named by their SHA-256; safe for several writers in several processes.

    Methods that send requests to a remote store may raise `StorageAway`.
    """

    def prepare(self) -> None:
        """Prepare the store for blobs; raises if it cannot be used."""

    def check(self) -> None:
        """Try to write; raises what `put` would raise now."""

    def put(self, blobs: Mapping[str, bytes]) -> None:
        """Store blobs by their digests; when this returns, they are durable.

        A blob that exists already counts as put now (see `remove`).
        """
        self.settle([self.draft(blobs)])

    def draft(self, blobs: Mapping[str, bytes]) -> Drafts:
        """Start putting blobs; call `settle` or `discard` afterwards."""

    def settle(self, many: Sequence[Drafts]) -> None:
        """Finish drafts: when this returns, their blobs are stored as by `put`."""

    def discard(self, many: Sequence[Drafts]) -> None:
        """Drop drafts, instead of `settle`."""

    def read(self, digest: str) -> bytes:
        """The bytes of a blob; DamagedFile if it is missing or its digest is wrong."""

    def open(self, digest: str, *, size_bytes: int | None) -> StoredBlob:
        """A blob to read from; DamagedFile if it is missing or of another size.

        Its content is not compared with the digest.
        """

    def open_verified(self, digest: str, *, size_bytes: int | None) -> StoredBlob:
        """As `open`; DamagedFile also if the content does not have this digest."""

    def require(self, digests: Iterable[str]) -> None:
        """Check that no blob was removed since it was put.

        Call it in the transaction that will refer to the blobs; it sends no request to
        another machine. Raises TryLater if one is missing: if the client sends it
        again, it is put again. Raises BlobsUncertain if a remote store has to be
        queried: end the transaction, call `make_sure`, and retry.
        """

    def make_sure(self, digests: Iterable[str]) -> None:
        """Check in a remote store that recently put blobs exist; TryLater if not.

        Call it outside of transactions, and only after `BlobsUncertain` has ended one.
        Blobs are removed only while holding the turn to write; so an earlier
        removal has ended by then, and for a later one these blobs are too young.
        """

    def put_missing(self, blobs: Mapping[str, bytes]) -> None:
        """Put the given blobs (content by digest), except those that are there.

        A stored blob of another size than its content counts as missing.
        """

    def remove(self, digests: Sequence[str], *, unused_since: float) -> dict[str, int]:
        """Remove blobs that were not put since a time; returns the removed sizes."""

    def adopt(self, file: Path) -> str:
        """Move a file from the temporary folder into the store; returns its digest."""

    def files(self) -> Iterator[StoredFile]:
        """All blobs of the store."""

    def leftovers(self) -> Iterator[tuple[Path, float]]:
        """Unfinished files on this machine, each with the time of its last change."""

    def temporary_folder(self) -> Path:
        """A folder on this machine for files that are being written."""

    def close(self) -> None:
        """Release threads and connections."""


_DIGEST: Final = re.compile(r"[0-9a-f]{64}")
_DRAFT: Final = ".new-"
_CHUNK: Final = 1 << 20


class StoredFile(NamedTuple):
    """A blob in a store, with its size and the time at which it was put."""

    digest: str
    size_bytes: int
    modified_at: float


def stored_files(folder: Path) -> Iterator[StoredFile]:
    """All blobs in a folder of blobs, sub-folder by sub-folder."""
    for entry in _entries(folder):
        if _DIGEST.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
            try:
                state = entry.stat(follow_symlinks=False)
            except FileNotFoundError:  # deleted since the folder was read
                continue
            yield StoredFile(entry.name, state.st_size, state.st_mtime)


def leftovers(folder: Path) -> Iterator[tuple[Path, float]]:
    """Drafts and unfinished exports, each with the time of its last change.

    Some of them are being written at this moment.
    """
    temporary = folder / "tmp"
    paths = [Path(entry) for entry in _entries(folder) if entry.name.startswith(_DRAFT)]
    if temporary.is_dir():
        paths += temporary.iterdir()
    for path in paths:
        try:
            times = [each.stat().st_mtime for each in (path, *path.rglob("*"))]
        except FileNotFoundError:
            continue
        yield path, max(times)


def left_over(store: BlobStore, at_work: Iterable[int], until: float) -> list[Path]:
    """Leftovers last changed before `until`, apart from files of exports at work."""
    names = {f"export-{number}" for number in at_work}
    return [
        path
        for path, changed_at in store.leftovers()
        if "-".join(path.name.split("-")[:2]) not in names and changed_at <= until
    ]


def digest_of(file: Path) -> str:
    """The digest of a file's content, which is read in pieces."""
    digest = hashlib.sha256()
    with file.open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def _entries(folder: Path) -> Iterator[os.DirEntry[str]]:
    for sub_folder in sorted(folder.glob("[0-9a-f][0-9a-f]")):
        with os.scandir(sub_folder) as entries:
            yield from entries
