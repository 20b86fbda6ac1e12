"""Locks that several processes agree on through the database."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from sqlalchemy import Engine, func, select

_MIGRATION: Final = 0x756E67686F7374  # "unghost"; any number that others do not use


@contextmanager
def migrating_alone(engine: Engine) -> Iterator[None]:
    """Let one process migrate while others wait.

    On SQLite the migration's own transaction is the lock.
    """
    if engine.dialect.name != "postgresql":
        yield
        return
    with engine.connect() as connection:
        connection.execute(select(func.pg_advisory_lock(_MIGRATION)))
        try:
            yield
        finally:
            connection.execute(select(func.pg_advisory_unlock(_MIGRATION)))
