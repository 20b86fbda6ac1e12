"""Checks the addresses in the settings: the database, the storage and the engine."""

from __future__ import annotations

import re
from importlib.util import find_spec
from ipaddress import ip_address
from typing import Final, NamedTuple
from urllib.parse import urlsplit

from sqlalchemy import make_url
from sqlalchemy.exc import ArgumentError

PSYCOPG: Final = "postgresql+psycopg"
_DATABASE_EXAMPLE: Final = "postgresql://USER:PASSWORD@HOST:5432/DATABASE"


def checked_url(text: str) -> str:
    """The URL of the database, with psycopg 3 as the driver for PostgreSQL.

    Raises ValueError: the database or its driver is not supported, or the text is no
    URL. The message quotes no part of the URL that may be a password.
    """
    try:
        url = make_url(text)
        # An @ of the password: what follows it would be named in errors as the host.
        first_key = text.partition("@")[2].partition("?")[2].partition("=")[0]
        if url.host and "@" in f"{url.host}/{url.database}?{first_key}":
            raise ArgumentError
    except (ArgumentError, ValueError):
        raise ValueError(
            f"it cannot be read as a URL like {_DATABASE_EXAMPLE}; characters such as "
            "@ : / ? in a password are written as %40 %3A %2F %3F"
        ) from None
    if url.drivername in ("sqlite", "sqlite+pysqlite"):
        if url.database in (None, "", ":memory:"):
            raise ValueError("a database in memory would be lost; name a file")
        return text
    if url.drivername not in ("postgres", "postgresql", PSYCOPG):
        raise ValueError(
            f"{url.drivername!r} is not supported; expected SQLite, or PostgreSQL "
            f"with psycopg 3: {_DATABASE_EXAMPLE}"
        )
    if find_spec("psycopg") is None:
        raise ValueError("PostgreSQL needs psycopg: pip install 'unghost[postgres]'")
    return url.set(drivername=PSYCOPG).render_as_string(hide_password=False)


LOCAL_ENGINE: Final = "local"
_ENGINE_FORM: Final = "local, tls://HOST:PORT, or tcp://HOST:PORT on this machine"


class EngineAddress(NamedTuple):
    """Where a scheduler listens."""

    scheme: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> EngineAddress:
        """The parts of an address; ValueError names the expected form."""
        scheme, separator, place = text.partition("://")
        host, _, port = place.rpartition(":")
        if not separator or scheme not in ("tls", "tcp") or not host:
            raise ValueError(f"{text!r} is not an engine; expected {_ENGINE_FORM}")
        if not port.isdigit() or int(port) > 65535:
            raise ValueError(f"{text!r} has no port; expected {_ENGINE_FORM}")
        return cls(scheme, host.strip("[]"), int(port))

    @property
    def is_encrypted(self) -> bool:
        """Whether the connection uses TLS, with certificates on both sides."""
        return self.scheme == "tls"

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach it."""
    if host.lower() == "localhost":
        return True
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def checked_engine(text: str, *, insecure: bool) -> str:
    """The engine of the settings, checked and in its normal form.

    Raises ValueError: it is not an engine, or it is not encrypted and on another
    machine: anyone who can connect to it could run code on every worker.
    """
    if text.lower() == LOCAL_ENGINE:
        return LOCAL_ENGINE
    address = EngineAddress.parse(text)
    if not (address.is_encrypted or insecure or is_loopback(address.host)):
        raise ValueError(
            f"{address} is not encrypted: anyone who can connect to it can run code on "
            "every worker. Use tls:// with certificates (`unghost certificates`), or "
            "allow it with UNGHOST_ENGINE_INSECURE=true"
        )
    return str(address)


FOLDER: Final = "folder"
_STORAGE_EXAMPLE: Final = "s3://BUCKET or s3://BUCKET/PREFIX"
_BUCKET: Final = re.compile(
    r"s3://(?P<name>[a-z0-9][a-z0-9.-]{1,61}[a-z0-9])"
    r"(?P<prefix>(?:/[\w!*'()-][\w!.*'()-]*)*)/?",
    re.ASCII,
)
"""Bucket names as Amazon allows them; prefixes of characters that need no escaping."""


def checked_storage(text: str) -> str:
    """The text, if it names a storage; ValueError, which does not quote it, if not."""
    if text != FOLDER and _BUCKET.fullmatch(text) is None:
        raise ValueError(f"expected {FOLDER}, {_STORAGE_EXAMPLE}")
    return text


def bucket_of(storage: str) -> tuple[str, str] | None:
    """The name of the S3 bucket that files are stored in, and the prefix of its keys.

    The prefix may be empty. None for the data folder.
    """
    match = _BUCKET.fullmatch(storage)
    return match and (match["name"], match["prefix"].strip("/"))


def checked_endpoint(text: str, *, plain: bool) -> str:
    """The address of an S3-compatible server, without a trailing slash.

    Raises ValueError: it is not an HTTP address; or it is plain HTTP to another
    machine, and `plain` is False. The message quotes nothing, since addresses may
    contain passwords.
    """
    try:
        parts = urlsplit(text)
        host, _ = parts.hostname, parts.port
    except ValueError:
        host = None
    if (
        not host
        or parts.scheme not in ("http", "https")
        or "@" in parts.netloc
        or any((parts.path.strip("/"), parts.query, parts.fragment))
    ):
        raise ValueError(
            "expected https://HOST or https://HOST:PORT, with no path, user or "
            "password; credentials come from AWS_ACCESS_KEY_ID and "
            "AWS_SECRET_ACCESS_KEY"
        )
    if parts.scheme == "http" and not plain and not is_loopback(host):
        raise ValueError(
            "without TLS, files would cross the network unencrypted: use https://, or "
            "allow it with UNGHOST_STORAGE_ALLOW_HTTP=true"
        )
    return text.rstrip("/")
