"""Blobs: files named by their content, durable before anything refers to them."""

from __future__ import annotations

from app.storage.blob_store import Blob, BlobStore, Drafts, sha256_of
from app.storage.durable import (
    flush_everything,
    flush_file,
    flush_folder,
    make_folder,
)
from app.storage.folder import FolderStorage
from app.storage.listing import (
    StoredFile,
    digest_of,
    export_of,
    leftovers,
    stored_files,
)
from app.storage.locking import FolderInUse, alone_in
from app.storage.opening import BLOBS, MissingLibrary, endpoint_of, open_store

__all__ = [
    "BLOBS",
    "Blob",
    "BlobStore",
    "Drafts",
    "FolderInUse",
    "FolderStorage",
    "MissingLibrary",
    "StoredFile",
    "alone_in",
    "digest_of",
    "endpoint_of",
    "export_of",
    "flush_everything",
    "flush_file",
    "flush_folder",
    "leftovers",
    "make_folder",
    "open_store",
    "sha256_of",
    "stored_files",
]
