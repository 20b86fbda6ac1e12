"""Connections to PostgreSQL, and its lock for writing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from sqlalchemy import URL, Connection, Engine, create_engine, event

from app.db.turns import Turns

WRITER: Final = 0x7772697465  # "write"; must differ from the keys of other locks
LOCK_WAIT_MS: Final = 30_000
LONGEST_IDLE_MS: Final = 20_000
"""How long a transaction that writes may be idle before the server ends it.

Otherwise a machine that is disconnected, or a process that hangs, would keep the lock
for hours. This is shorter than other transactions wait for the lock, and longer than a
request to the file storage that is made while the lock is held.
"""
KEPT_CONNECTIONS: Final = 8
MOST_CONNECTIONS: Final = 32
"""Most connections of one process.

Three processes fit into the 100 that a server allows by default.
"""
_CONNECT_ARGS: Final[Mapping[str, str]] = {
    "application_name": "unghost",
    "connect_timeout": "10",
    # A server whose machine is gone is detected within a minute.
    "keepalives_idle": "30",
    "keepalives_interval": "10",
    "keepalives_count": "3",
}
_BEGIN_WRITING: Final = (
    f"SELECT set_config('lock_timeout', '{LOCK_WAIT_MS}', true), "
    f"set_config('idle_in_transaction_session_timeout', '{LONGEST_IDLE_MS}', true), "
    f"pg_advisory_xact_lock({WRITER})"
)


def make_postgres_engine(
    url: URL, *, only_read: bool = False, turns: Turns | None = None
) -> Engine:
    """An engine that tests connections before use, so the server may restart."""
    # Those in the URL come first.
    arguments = {name: v for name, v in _CONNECT_ARGS.items() if name not in url.query}
    engine = create_engine(
        url,
        pool_size=KEPT_CONNECTIONS,
        max_overflow=MOST_CONNECTIONS - KEPT_CONNECTIONS,
        pool_pre_ping=True,
        hide_parameters=True,
        connect_args=arguments,
        # Regardless of the server's default: after waiting for the lock, a writer must
        # see what others have written.
        isolation_level="READ COMMITTED",
        # Not False: that would override a database that somebody made read-only.
        execution_options={"postgresql_readonly": True} if only_read else {},
    )
    if turns is not None:  # in this process first, then among all processes
        turns.apply_to(engine)

    # Runs, uploads and answers all change a dataset's counts and its active rows. As on
    # SQLite, one transaction writes at a time, so that none has to handle conflicts.
    def begin(connection: Connection) -> None:
        if connection.get_execution_options().get("writes", False):
            connection.exec_driver_sql(_BEGIN_WRITING)

    event.listen(engine, "begin", begin)
    return engine
