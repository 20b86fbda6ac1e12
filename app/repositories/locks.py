"""Locks that several processes agree on through the database."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from sqlalchemy import Engine, func, select
from sqlalchemy.orm import Session

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


def keep_turn(session: Session) -> None:
    """Let a writer be silent in its turn for as long as it takes.

    For those who change something else than the database, which must not go on when
    somebody else writes by now.
    """
    if session.connection().dialect.name == "postgresql":
        named = "idle_in_transaction_session_timeout"
        session.execute(select(func.set_config(named, "0", True)))
