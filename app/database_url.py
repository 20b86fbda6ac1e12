"""Which databases a URL may name: SQLite, and PostgreSQL through psycopg 3."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

from sqlalchemy import URL, make_url
from sqlalchemy.exc import ArgumentError

PSYCOPG: Final = "postgresql+psycopg"
_POSTGRES: Final = ("postgres", "postgresql", PSYCOPG)
_SQLITE: Final = ("sqlite", "sqlite+pysqlite")
_EXAMPLE: Final = "postgresql://USER:PASSWORD@HOST:5432/DATABASE"


def checked_url(text: str) -> str:
    """The URL with the driver that is used.

    Raises
    ------
    ValueError
        It names another database or driver, or nothing at all. The reason quotes no
        part of the URL that may be a password.
    """
    url = _parsed(text)
    if url.drivername in _SQLITE:
        if url.database in (None, "", ":memory:"):
            raise ValueError("a database in memory would be lost; name a file")
        return text
    if url.drivername not in _POSTGRES:
        raise ValueError(
            f"{url.drivername!r} is not known here; the database is SQLite, or "
            f"PostgreSQL with psycopg 3: {_EXAMPLE}"
        )
    if find_spec("psycopg") is None:
        raise ValueError("PostgreSQL needs psycopg: pip install 'unghost[postgres]'")
    return url.set(drivername=PSYCOPG).render_as_string(hide_password=False)


def _parsed(text: str) -> URL:
    try:
        return make_url(text)
    except (ArgumentError, ValueError):
        raise ValueError(
            f"it cannot be read as a URL like {_EXAMPLE}; characters such as @ : / "
            "in a password are written as %40 %3A %2F"
        ) from None
