"""Whether the database can be written: by writing it, with a change of nothing."""

from __future__ import annotations

from typing import Final

from sqlalchemy import Connection
from sqlalchemy.exc import OperationalError

from app.db.engine import BUSY_TIMEOUT_MS, Database

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
        _be_patient(connection, sqlite, PATIENCE_MS)
        try:
            connection.exec_driver_sql(_NOTHING_NEW)
            connection.commit()
        except OperationalError as exc:
            if any(word in str(exc.orig).lower() for word in _BUSY):
                return False
            raise
        finally:
            connection.rollback()
            if sqlite:
                _be_patient(connection, sqlite, BUSY_TIMEOUT_MS)
    return True


def _be_patient(connection: Connection, sqlite: bool, for_ms: int) -> None:
    setting = f"PRAGMA busy_timeout={for_ms}"
    if not sqlite:
        setting = f"SET LOCAL lock_timeout = {for_ms}"
    connection.exec_driver_sql(setting)
