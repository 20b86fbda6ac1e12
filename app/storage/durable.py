"""Flushes files and folders to the disk, and locks a folder for one process."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final


def flush_file(file: Path) -> None:
    """Flush the content of a file to the disk."""
    descriptor = os.open(file, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def flush_folder(folder: Path) -> None:
    """Flush the entries of a folder to the disk."""
    # A rename is only durable once its folder is. Windows cannot open folders, and
    # does not need to.
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


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


_LOCK: Final = ".maintenance.lock"


class FolderInUse(Exception):
    """Another process has locked the folder."""


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Lock a folder; the operating system releases the lock when the process ends.

    Raises
    ------
    FolderInUse
        Another process has locked it.
    """
    descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        try:
            _lock(descriptor)
        except OSError as exc:
            raise FolderInUse(str(folder)) from exc
        yield
    finally:
        os.close(descriptor)


if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int) -> None:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
