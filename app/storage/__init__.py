"""Storage of blobs, which are files named by the SHA-256 digest of their content."""

from __future__ import annotations

import os
from typing import Final

from app.addresses import bucket_of
from app.settings import Settings
from app.storage.base import BlobStore
from app.storage.folder import FolderStorage

BLOBS: Final = "blobs"
_DEFAULT_REGION: Final = "us-east-1"


class MissingLibrary(Exception):
    """The settings need an extra that is not installed."""


def open_store(settings: Settings) -> BlobStore:
    """The storage of the settings; call `prepare` before using it.

    Raises MissingLibrary if the storage is S3, and its library is not installed.
    """
    local = settings.data / BLOBS
    bucket = bucket_of(settings.storage)
    if bucket is None:
        return FolderStorage(local, make=False)
    try:
        from app.storage.s3 import S3Place, S3Storage
    except ImportError as exc:
        raise MissingLibrary(
            "files in S3 need a library: pip install 'unghost[s3]'"
        ) from exc
    name, prefix = bucket
    place = S3Place(
        bucket=name,
        prefix=prefix,
        endpoint=endpoint_of(settings),
        region=settings.storage_region,
        plain=(settings.storage_endpoint or "").startswith("http:"),
        timeout_s=settings.storage_timeout_s,
    )
    return S3Storage(place, local)


def endpoint_of(settings: Settings) -> str:
    """The address of the S3 server; Amazon's if the settings name none."""
    variables = ("AWS_REGION", "AWS_DEFAULT_REGION")
    named = [os.environ[name] for name in variables if os.environ.get(name)]
    region = settings.storage_region or (named[0] if named else _DEFAULT_REGION)
    return settings.storage_endpoint or f"https://s3.{region}.amazonaws.com"
