"""What every store of files does, a folder or a bucket, and what lies in it."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple, Protocol

PIECE: Final = 4 * 1024**2
"""Bytes of a blob that are held at a time while it is sent."""


def sha256_of(data: bytes) -> str:
    """The name of a blob."""
    return hashlib.sha256(data).hexdigest()


def place_of(digest: str) -> str:
    """Where a blob lies below a store's folder or prefix: from its digest alone."""
    if len(digest) != 64 or not set(digest) <= set("0123456789abcdef"):
        raise ValueError(f"not a SHA-256 digest: {digest!r}")
    return f"{digest[:2]}/{digest}"


class Drafts:
    """Blobs on their way into a store; only that store looks inside."""


class Unsure(Exception):
    """Only a store on another machine knows whether these blobs are there.

    It ends the transaction that would refer to them, as nobody should wait to write
    while a store is asked. Then `BlobStore.make_sure` asks, and the transaction is
    tried again.
    """

    def __init__(self, digests: Sequence[str]) -> None:
        super().__init__(f"{len(digests)} blobs have to be asked for")
        self.digests = digests


@dataclass(frozen=True)
class Blob:
    """A stored blob, read in parts.

    `part` gives the bytes from the first offset up to the second; `path` is where the
    blob lies if it is a file of this machine.
    """

    size_bytes: int
    part: Callable[[int, int], bytes]
    path: Path | None = None

    def pieces(self, first: int = 0, end: int | None = None) -> Iterator[bytes]:
        """The bytes from `first` up to `end`, some megabytes at a time."""
        end = self.size_bytes if end is None else end
        for start in range(first, end, PIECE):
            yield self.part(start, min(start + PIECE, end))

    def digest(self) -> str:
        """The digest of the content; it is never held as a whole."""
        found = hashlib.sha256()
        for piece in self.pieces():
            found.update(piece)
        return found.hexdigest()


class BlobStore(Protocol):
    """Blobs named by their SHA-256; safe for several writers in several processes.

    Whatever asks a store on another machine may raise `StorageAway`.
    """

    def prepare(self) -> None:
        """Make the place ready for blobs, or say by an error why it cannot be."""

    def check(self) -> None:
        """Put something of no use; raises what putting a blob would raise now."""

    def put(self, blobs: Mapping[str, bytes]) -> None:
        """Store blobs by their digests; when this returns they survive a power cut.

        A blob that is there already counts as new from now on.
        """

    def draft(self, blobs: Mapping[str, bytes]) -> Drafts:
        """Begin to put blobs; `settle` or `discard` them afterwards."""

    def settle(self, many: Sequence[Drafts]) -> None:
        """Return when all blobs of drafts are put, as by `put`."""

    def discard(self, many: Sequence[Drafts]) -> None:
        """Give up drafts that nobody wants any more."""

    def read(self, digest: str) -> bytes:
        """A blob's bytes; DamagedFile if it is gone, or not what was stored."""

    def whole(self, digest: str, *, size_bytes: int | None) -> Blob:
        """A blob to read from; DamagedFile if it is gone or of another size.

        Its content is not looked at: whoever gets it can do that.
        """

    def intact(self, digest: str, *, size_bytes: int | None) -> Blob:
        """A blob whose content is what was stored; else DamagedFile."""

    def require(self, digests: Iterable[str]) -> None:
        """Refuse to refer to a blob that somebody took away since it was put.

        To be called in the transaction that refers to the blobs; no other machine is
        asked.

        Raises
        ------
        TryLater
            One is gone; sent again, it is put again.
        Unsure
            Another machine has to be asked: end the transaction, call `make_sure`, and
            begin again.
        """

    def make_sure(self, digests: Iterable[str]) -> None:
        """Find out whether blobs are there that were put a moment ago.

        To be called outside of transactions, and only after a transaction that `Unsure`
        ended: whoever takes blobs away holds the turn to write meanwhile, so an older
        attempt to take them away is over by then, and a later one finds them too young.

        Raises
        ------
        TryLater
            One is gone; sent again, it is put again.
        """

    def mend(self, blobs: Mapping[str, bytes]) -> None:
        """Put those of stored blobs again that are gone, or of another size."""

    def remove(self, digests: Sequence[str], *, unused_since: float) -> dict[str, int]:
        """Take blobs away but for those put since; sizes of those that were taken."""

    def adopt(self, file: Path) -> str:
        """Put a finished file of the temporary folder, and take it from there."""

    def files(self) -> Iterator[StoredFile]:
        """Every blob that there is."""

    def leftovers(self) -> Iterator[tuple[Path, float]]:
        """What is half written on this machine, with the times of the last changes."""

    def temporary_folder(self) -> Path:
        """A folder of this machine for files that are being written."""

    def close(self) -> None:
        """Give back threads and connections."""


_DIGEST: Final = re.compile(r"[0-9a-f]{64}")
_DRAFT: Final = ".new-"
_CHUNK: Final = 1 << 20


class StoredFile(NamedTuple):
    """A blob as it lies there."""

    digest: str
    size_bytes: int
    modified_at: float


def stored_files(folder: Path) -> Iterator[StoredFile]:
    """Every blob in a folder of blobs, one sub-folder after the other."""
    for entry in _entries(folder):
        if _DIGEST.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
            try:
                found = entry.stat(follow_symlinks=False)
            except FileNotFoundError:  # gone since the folder was read
                continue
            yield StoredFile(entry.name, found.st_size, found.st_mtime)


def leftovers(folder: Path) -> Iterator[tuple[Path, float]]:
    """Drafts and half exports, each with the time of its last change.

    Some of them are being written just now.
    """
    temporary = folder / "tmp"
    found = [Path(entry) for entry in _entries(folder) if entry.name.startswith(_DRAFT)]
    if temporary.is_dir():
        found += temporary.iterdir()
    for path in found:
        try:
            yield path, _last_change(path)
        except FileNotFoundError:
            continue


def export_of(leftover: Path) -> str:
    """The export of a leftover, as ``export-7``; each attempt has its own folder."""
    return "-".join(leftover.name.split("-")[:2])


def digest_of(file: Path) -> str:
    """The digest of a file's content; it is never held as a whole."""
    digest = hashlib.sha256()
    with file.open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def _entries(folder: Path) -> Iterator[os.DirEntry[str]]:
    for sub_folder in sorted(folder.glob("[0-9a-f][0-9a-f]")):
        with os.scandir(sub_folder) as entries:
            yield from entries


def _last_change(path: Path) -> float:
    times = [path.stat().st_mtime]
    times += [inner.stat().st_mtime for inner in path.rglob("*")]
    return max(times)
