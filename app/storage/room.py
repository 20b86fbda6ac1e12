"""Room on the disk: asked for before anything is taken in, and a reserve for deleting.

On a full disk SQLite can delete nothing, because it first writes down what it is about
to change. So the data folder holds a file that is only there to be given up then.
"""

from __future__ import annotations

import io
import logging
import os
import shutil
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from app.errors import StorageFull
from app.settings import Settings
from app.storage import BlobStore

RESERVE: Final = ".reserve"
RESERVE_BYTES: Final = 32 * 1024**2
MOST_OF_DISK: Final = 16
"""The reserve is at most the disk's size divided by this."""
DELETING_BYTES: Final = 4 * 1024**2
"""Bytes that a request which deletes writes at most.

Deleting a frame of very many revisions writes more.
"""
RETRY_S: Final = 30
_PIECE: Final = 1024**2

log = logging.getLogger(__name__)


def free_bytes(folders: Iterable[Path]) -> int:
    """Bytes that are free on the disks of these folders: the least of them."""
    return min(shutil.disk_usage(folder).free for folder in folders)


def require_room(settings: Settings, store: BlobStore) -> None:
    """Refuse to take something in where too little would stay free.

    Raises
    ------
    StorageFull
        Less is free than `min_free_bytes`.
    """
    free = free_bytes((settings.data, store.temporary_folder()))
    if free < settings.min_free_bytes:
        raise StorageFull(
            f"{free} bytes are free on the disk of the service, and "
            f"{int(settings.min_free_bytes)} have to stay free; nothing more is stored "
            "until there is room",
            retry_after_s=RETRY_S,
        )


class DeletionSignal(threading.Event):
    """Set when something was deleted: rows are to go, the reserve is to be taken."""


class Reserve:
    """A file of a data folder that is given up when there is no room to delete."""

    def __init__(self, data: Path) -> None:
        self.path = data / RESERVE

    @property
    def size_bytes(self) -> int:
        """How large it is where there is room for it."""
        return min(
            RESERVE_BYTES, shutil.disk_usage(self.path.parent).total // MOST_OF_DISK
        )

    def give_up(self, needed_bytes: int | None = None) -> bool:
        """Give the reserve up if there is too little room to delete; whether it did.

        Too little is less than `needed_bytes`, or, without them, less than the size of
        the reserve.
        """
        needed = self.size_bytes if needed_bytes is None else needed_bytes
        if self.path.exists() and free_bytes([self.path.parent]) < needed:
            self.path.unlink(missing_ok=True)
            log.warning("the disk is full: the reserve is given up to delete something")
            return True
        return False

    def keep(self, min_free_bytes: int) -> None:
        """Take the reserve again, if `min_free_bytes` stay free beside it."""
        size = self.size_bytes
        if self.path.exists() or free_bytes([self.path.parent]) < size + min_free_bytes:
            return
        try:
            # Its owner's alone, as all that the service puts there.
            number = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(number, "wb", buffering=0) as file:
                _take(file, size)
        except OSError as exc:
            self.path.unlink(missing_ok=True)
            log.warning("there is no reserve for a full disk: %s", exc.strerror)


def _take(file: io.RawIOBase, size: int) -> None:
    """Let a file have so many bytes of the disk; a hole would have none."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
        return
    for _ in range(0, size, _PIECE):
        file.write(bytes(_PIECE))
