"""Blobs: files named by their content, durable before anything refers to them."""

from __future__ import annotations

from app.storage.durable import (
    flush_everything,
    flush_file,
    flush_folder,
    make_folder,
)
from app.storage.folder import Drafts, FolderStorage, sha256_of
from app.storage.listing import StoredFile, digest_of, leftovers, stored_files
from app.storage.locking import FolderInUse, alone_in

__all__ = [
    "Drafts",
    "FolderInUse",
    "FolderStorage",
    "StoredFile",
    "alone_in",
    "digest_of",
    "flush_everything",
    "flush_file",
    "flush_folder",
    "leftovers",
    "make_folder",
    "sha256_of",
    "stored_files",
]
