"""Where files are kept, as the settings name it: the data folder, or a bucket of S3."""

from __future__ import annotations

import re
from ipaddress import ip_address
from typing import Final, NamedTuple
from urllib.parse import SplitResult, urlsplit

FOLDER: Final = "folder"
_EXAMPLE: Final = "s3://BUCKET or s3://BUCKET/PREFIX"
_BUCKET: Final = re.compile(
    r"s3://(?P<name>[a-z0-9][a-z0-9.-]{1,61}[a-z0-9])"
    r"(?P<prefix>(?:/[\w!*'()-][\w!.*'()-]*)*)/?",
    re.ASCII,
)
"""Buckets as Amazon allows them, prefixes of characters that no server quotes."""


class Bucket(NamedTuple):
    """A bucket of S3, and what the keys in it begin with; an empty text: nothing."""

    name: str
    prefix: str


def checked_storage(text: str) -> str:
    """The text, if it names a place for files; else ValueError that quotes nothing."""
    if text != FOLDER and _BUCKET.fullmatch(text) is None:
        raise ValueError(f"expected {FOLDER}, {_EXAMPLE}")
    return text


def bucket_of(storage: str) -> Bucket | None:
    """The bucket that files are kept in; None if that is the data folder."""
    found = _BUCKET.fullmatch(storage)
    return found and Bucket(found["name"], found["prefix"].strip("/"))


def checked_endpoint(text: str, *, plain: bool) -> str:
    """The address of a server that speaks S3, without a slash at its end.

    Raises
    ------
    ValueError
        It is no such address; or one without TLS on another machine, and `plain` does
        not allow that. The reason quotes nothing: people put passwords into addresses.
    """
    try:
        parts = urlsplit(text)
        host, _ = parts.hostname, parts.port
    except ValueError:
        host = None
    if not host or parts.scheme not in ("http", "https") or _has_more(parts):
        raise ValueError(
            "expected https://HOST or https://HOST:PORT, with no path, user or "
            "password; credentials come from AWS_ACCESS_KEY_ID and "
            "AWS_SECRET_ACCESS_KEY"
        )
    if parts.scheme == "http" and not plain and not _is_this_machine(host):
        raise ValueError(
            "without TLS, files would travel readable for everybody in between: use "
            "https://, or allow it with UNGHOST_STORAGE_ALLOW_HTTP=true"
        )
    return text.rstrip("/")


def _has_more(parts: SplitResult) -> bool:
    return bool(
        parts.path.strip("/") or parts.query or parts.fragment or "@" in parts.netloc
    )


def _is_this_machine(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
