"""Flushes files and folders to the disk, and locks a folder for one process."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final


def flush_file(file: Path, flags: int = os.O_RDWR) -> None:
    """Flush the content of a file to the disk."""
    descriptor = os.open(file, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def flush_folder(folder: Path) -> None:
    """Flush the entries of a folder to the disk."""
    # A rename is only durable once its folder is. Windows cannot open folders, and
    # does not need to.
    if os.name != "nt":
        flush_file(folder, os.O_RDONLY)


def flush_everything(folder: Path) -> None:
    """Flush everything below a folder to the disk."""
    if hasattr(os, "sync"):
        # Flushes a hundred thousand files at once instead of one by one.
        os.sync()
        return
    for path in folder.rglob("*"):
        if path.is_file():
            flush_file(path)


def make_folder(folder: Path, mode: int = 0o700) -> None:
    """Create a folder and its parents durably.

    If a power failure lost the folder, it would lose everything in it, even if flushed.
    """
    if folder.is_dir():
        return
    make_folder(folder.parent, mode)
    folder.mkdir(mode=mode, exist_ok=True)
    flush_folder(folder.parent)


MAINTENANCE_LOCK: Final = ".maintenance.lock"
"""The file that a backup or a garbage collection locks in a data folder."""
SERVER_LOCK: Final = ".server.lock"
"""The file that a server with SQLite locks in its data folder."""
_MOST_NOTED: Final = 1000


class InUse(Exception):
    """Another process holds the lock; the text is what that process noted."""


class CannotLock(Exception):
    """The file system has no locks, as some network mounts; the text is its reason."""


@contextmanager
def locked(file: Path) -> Iterator[Callable[[str], None]]:
    """Lock a file, which is created; the lock ends with the process, however that ends.

    The yielded function replaces the note that other processes find while it is locked.
    Raises InUse if another process has locked it, CannotLock if no process can.
    """
    # Python opens files so that no child process inherits them, and with them the lock.
    descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o600)

    def note(text: str) -> None:
        with suppress(OSError):  # a full disk: the lock holds without a note
            os.ftruncate(descriptor, 0)
            os.lseek(descriptor, 0, os.SEEK_SET)
            os.write(descriptor, text.encode())

    try:
        try:
            _lock(descriptor)
        except (BlockingIOError, PermissionError) as exc:
            os.lseek(descriptor, 0, os.SEEK_SET)
            noted = os.read(descriptor, _MOST_NOTED)
            raise InUse(noted.decode("utf-8", "replace")) from exc
        except OSError as exc:
            raise CannotLock(exc.strerror or str(exc)) from exc
        note("")
        yield note
    finally:
        os.close(descriptor)


if sys.platform == "win32":
    import msvcrt

    # Beyond the note: a locked part of a file cannot be read there.
    _LOCKED_BYTE: Final = 1 << 20

    def _lock(descriptor: int) -> None:
        os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
