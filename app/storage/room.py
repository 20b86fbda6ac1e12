"""Checks that the disk has space for uploads, and keeps a reserve for deletions.

On a full disk SQLite cannot delete anything, because it first writes its log. So the
data folder contains a placeholder file, which is deleted in that case.
"""

from __future__ import annotations

import logging
import os
import shutil
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from app.errors import StorageFull
from app.settings import Settings
from app.storage.base import BlobStore

RESERVE: Final = ".reserve"
RESERVE_BYTES: Final = 32 * 1024**2
MOST_OF_DISK: Final = 16
"""The reserve is at most the disk's size divided by this."""
DELETING_BYTES: Final = 4 * 1024**2
"""Bytes that a request for a deletion writes at most.

Deleting a frame with very many revisions writes more.
"""
LEFT_BY_ANSWERS: Final = 4
"""Answers on single boxes leave `min_free_bytes`, divided by this, free.

By default these are 64 MiB, the size at which SQLite copies its log into the file of
the database (`app.db.engine.WAL_PAGES`): there is still room to do that and to delete.
"""
RETRY_S: Final = 30
_PIECE: Final = 1024**2

log = logging.getLogger(__name__)


def free_bytes(folders: Iterable[Path]) -> int:
    """The smallest number of free bytes on the disks of these folders."""
    return min(shutil.disk_usage(folder).free for folder in folders)


def require_room(settings: Settings, store: BlobStore, needed_bytes: int = 0) -> None:
    """Refuse what is to be stored if there is too little free disk space.

    Raises StorageFull if fewer than `min_free_bytes` would be free after `needed_bytes`
    more.
    """
    free = free_bytes((settings.data, store.temporary_folder()))
    _require_free(free, int(settings.min_free_bytes), needed_bytes)


def require_room_for_answer(settings: Settings, folder: Path) -> None:
    """Refuse an answer on a single box if the database's disk is almost full.

    Answers are small, and people go on with them below `min_free_bytes`. But sent by a
    program, with long comments, they would take the last byte within minutes. Raises
    StorageFull if less than a quarter of it is free on the disk of `folder`.
    """
    min_free = int(settings.min_free_bytes) // LEFT_BY_ANSWERS
    _require_free(free_bytes((folder,)), min_free)


def _require_free(free: int, min_free: int, needed_bytes: int = 0) -> None:
    """Raise StorageFull if fewer than `min_free` bytes would stay free."""
    if free - needed_bytes < min_free:
        needed = f", and this needs up to {needed_bytes} more" if needed_bytes else ""
        raise StorageFull(
            f"{free} bytes are free on the disk of the service, and {min_free} have to "
            f"stay free{needed}; this is not stored until there is more disk space",
            retry_after_s=RETRY_S,
        )


class DeletionSignal(threading.Event):
    """Set after a deletion, so that rows are removed and the reserve is restored."""


class Reserve:
    """A placeholder file that is deleted to make disk space for deletions."""

    def __init__(self, data: Path) -> None:
        self.path = data / RESERVE

    @property
    def size_bytes(self) -> int:
        """Its size: `RESERVE_BYTES`, or less on a small disk."""
        return min(
            RESERVE_BYTES, shutil.disk_usage(self.path.parent).total // MOST_OF_DISK
        )

    def give_up(self, needed_bytes: int | None = None) -> bool:
        """Delete the reserve if there is too little disk space; returns if it did.

        Too little is less than `needed_bytes`, by default the size of the reserve.
        """
        if not self.path.exists():
            return False
        needed = self.size_bytes if needed_bytes is None else needed_bytes
        if free_bytes([self.path.parent]) < needed:
            self.path.unlink(missing_ok=True)
            log.warning("the disk is full: the reserve is released for a deletion")
            return True
        return False

    def keep(self, min_free_bytes: int) -> None:
        """Create a missing reserve, if `min_free_bytes` stay free in addition."""
        size = self.size_bytes
        if self.path.exists() or free_bytes([self.path.parent]) < size + min_free_bytes:
            return
        try:
            # Readable by its owner alone, as all files of the service.
            number = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(number, "wb", buffering=0) as file:
                # Not a sparse file, which would take no space.
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(file.fileno(), 0, size)
                else:
                    for _ in range(0, size, _PIECE):
                        file.write(bytes(_PIECE))
        except OSError as exc:
            self.path.unlink(missing_ok=True)
            log.warning("there is no reserve for a full disk: %s", exc.strerror)
