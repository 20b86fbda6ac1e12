"""What lies in the folder of the blobs, whoever put it there."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

_DIGEST: Final = re.compile(r"[0-9a-f]{64}")
_DRAFT: Final = ".new-"
_CHUNK: Final = 1 << 20


class StoredFile(NamedTuple):
    """A blob as it lies there."""

    digest: str
    size_bytes: int
    modified_at: float


def stored_files(folder: Path) -> Iterator[StoredFile]:
    """Every blob of a folder of blobs, folder by folder."""
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
