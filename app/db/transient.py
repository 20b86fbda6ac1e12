"""Which database errors are temporary, and whether the database can be written now."""

from __future__ import annotations

from typing import Final

from sqlalchemy import Connection
from sqlalchemy import exc as sql
from sqlalchemy.exc import OperationalError
from sqlalchemy.exc import TimeoutError as WaitedTooLong

from app.db.engine import BUSY_TIMEOUT_MS, Database

_TOO_MANY_CONNECTIONS: Final = "53300"
_QUERY_CANCELED: Final = "57014"
"""A timeout ended a statement, and would do so again."""
_NO_RESOURCES: Final = "53"
_BUSY_STATES: Final = ("locked", "busy")


def is_transient(exc: Exception) -> bool:
    """Whether the database was unavailable, or another transaction wrote for too long.

    False if the disk or the memory is full: a retry does not help.
    """
    if isinstance(exc, sql.TimeoutError):
        return True
    if not isinstance(exc, (sql.OperationalError, sql.InterfaceError)):
        return False
    if "sqlite" in type(exc.orig).__module__:
        return any(word in str(exc.orig).lower() for word in _BUSY_STATES)
    # There is no state if no connection was made, or if it broke.
    state: str = getattr(exc.orig, "sqlstate", None) or ""
    if state == _TOO_MANY_CONNECTIONS:
        return True
    return state != _QUERY_CANCELED and not state.startswith(_NO_RESOURCES)


def in_a_line(exc: Exception) -> str:
    """The first line of an error, for the log: without its statement and parameters."""
    return str(exc).partition("\n")[0]


WRITE_WAIT_MS: Final = 1000
_EMPTY_WRITE: Final = "UPDATE alembic_version SET version_num = version_num"
_BUSY: Final = ("locked", "busy", "lock timeout")


def takes_writes(database: Database) -> bool:
    """True after a durable write; False if another transaction held the lock.

    Raises SQLAlchemyError if the database cannot be written.
    """
    sqlite = database.engine.dialect.name == "sqlite"
    with database.engine.connect() as connection:
        if sqlite:
            # It waits for its turn as other writers do, with a shorter timeout.
            _wait_for_others(connection, WRITE_WAIT_MS)
            connection.execution_options(
                writes=True, person=True, turn_wait_s=WRITE_WAIT_MS / 1000
            )
        try:
            if not sqlite:
                connection.exec_driver_sql(f"SET LOCAL lock_timeout = {WRITE_WAIT_MS}")
            connection.exec_driver_sql(_EMPTY_WRITE)
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
    # By the driver itself, since it has to be set before the transaction begins.
    driver = connection.connection.dbapi_connection
    if driver is not None:
        driver.cursor().execute(f"PRAGMA busy_timeout={for_ms}")
