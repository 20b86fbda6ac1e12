"""What every store of blobs does, whether it is a folder or a bucket."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from app.storage.listing import StoredFile

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
    """Blobs on their way into a store; nobody but this store looks inside."""


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
