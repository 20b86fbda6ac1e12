"""Carrying files and names of files to the disk."""

from __future__ import annotations

import os
from pathlib import Path


def flush_file(file: Path) -> None:
    """Return when the content of a file is on the disk."""
    descriptor = os.open(file, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def flush_folder(folder: Path) -> None:
    """Return when the names in a folder are on the disk."""
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
    """Return when all files and names below a folder are on the disk."""
    if hasattr(os, "sync"):
        # A hundred thousand files at once, not one after the other.
        os.sync()
        return
    for path in folder.rglob("*"):
        if path.is_file():
            flush_file(path)


def make_folder(folder: Path, mode: int = 0o700) -> None:
    """Make a folder, and those above it, of which a power cut leaves all or none.

    What is written into a folder is lost with it, however well it was flushed itself.
    """
    if folder.is_dir():
        return
    make_folder(folder.parent, mode)
    folder.mkdir(mode=mode, exist_ok=True)
    flush_folder(folder.parent)
