"""Failures of a database that end by themselves, and whether it takes writes now."""

from __future__ import annotations

from typing import Final

from sqlalchemy import Connection
from sqlalchemy import exc as sql
from sqlalchemy.exc import OperationalError
from sqlalchemy.exc import TimeoutError as WaitedTooLong

from app.db.engine import BUSY_TIMEOUT_MS, Database

_TOO_MANY_CONNECTIONS: Final = "53300"
_TOLD_TO_END: Final = "57014"
"""A statement was ended for what it is: it would be again."""
_NO_ROOM: Final = "53"
_BUSY_STATES: Final = ("locked", "busy")


def is_transient(exc: Exception) -> bool:
    """Whether the database was away, or somebody else has written for too long.

    False for a disk or a memory that is full: that does not end by waiting.
    """
    if isinstance(exc, sql.TimeoutError):
        return True
    if not isinstance(exc, (sql.OperationalError, sql.InterfaceError)):
        return False
    if "sqlite" in type(exc.orig).__module__:
        return any(word in str(exc.orig).lower() for word in _BUSY_STATES)
    # None where a connection was not made, or broke off without a word.
    state: str = getattr(exc.orig, "sqlstate", None) or ""
    if state == _TOO_MANY_CONNECTIONS:
        return True
    return state != _TOLD_TO_END and not state.startswith(_NO_ROOM)


def in_a_line(exc: Exception) -> str:
    """What to say of it in a log: no statement, and nothing that people wrote."""
    return str(exc).partition("\n")[0]


PATIENCE_MS: Final = 1000
_NOTHING_NEW: Final = "UPDATE alembic_version SET version_num = version_num"
_BUSY: Final = ("locked", "busy", "lock timeout")


def takes_writes(database: Database) -> bool:
    """True after a durable write; False if somebody else is writing for longer.

    Raises
    ------
    SQLAlchemyError
        It cannot be written.
    """
    sqlite = database.engine.dialect.name == "sqlite"
    with database.engine.connect() as connection:
        if sqlite:
            # In the queue of the writers, but not for as long as they wait.
            _wait_for_others(connection, PATIENCE_MS)
            connection.execution_options(
                writes=True, person=True, turn_wait_s=PATIENCE_MS / 1000
            )
        try:
            if not sqlite:
                connection.exec_driver_sql(f"SET LOCAL lock_timeout = {PATIENCE_MS}")
            connection.exec_driver_sql(_NOTHING_NEW)
            connection.commit()
        except WaitedTooLong:
            return False
        except OperationalError as exc:
            if any(word in str(exc.orig).lower() for word in _BUSY):
                return False
            raise
        finally:
            connection.rollback()
            if sqlite:
                _wait_for_others(connection, BUSY_TIMEOUT_MS)
    return True


def _wait_for_others(connection: Connection, for_ms: int) -> None:
    # To the driver itself: this is to hold before the transaction begins.
    driver = connection.connection.dbapi_connection
    if driver is not None:
        driver.cursor().execute(f"PRAGMA busy_timeout={for_ms}")
