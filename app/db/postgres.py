"""PostgreSQL: how its URLs are read, and how connections to it are made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from sqlalchemy import URL, Connection, Engine, create_engine, event

from app.db.turns import Turns

WRITER: Final = 0x7772697465  # "write"; any number that other locks do not have
LOCK_WAIT_MS: Final = 30_000
LONGEST_IDLE_MS: Final = 20_000
"""How long a transaction that writes may be idle before the server ends it.

Otherwise a machine that vanished, or a process that hangs, would keep the turn to write
for hours. This is shorter than others wait for their turn, and longer than a request to
the file storage within a turn takes.
"""
KEPT_CONNECTIONS: Final = 8
MOST_CONNECTIONS: Final = 32
"""For one process: three processes fit into the 100 that a server allows by default."""
_CONNECT_ARGS: Final[Mapping[str, str]] = {
    "application_name": "unghost",
    "connect_timeout": "10",
    # A server that vanished with its machine is noticed within a minute.
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
    engine = create_engine(
        url,
        pool_size=KEPT_CONNECTIONS,
        max_overflow=MOST_CONNECTIONS - KEPT_CONNECTIONS,
        pool_pre_ping=True,
        hide_parameters=True,
        connect_args=_arguments(url),
        # Whatever the server's default is: a writer that waited sees what others wrote.
        isolation_level="READ COMMITTED",
        # Not False: that would override a database that somebody made read-only.
        execution_options={"postgresql_readonly": True} if only_read else {},
    )
    if turns is not None:  # in this process first, then among all processes
        turns.apply_to(engine)
    event.listen(engine, "begin", _begin)
    return engine


def _arguments(url: URL) -> dict[str, object]:
    """The parameters of connections, but for those in the URL."""
    return {name: text for name, text in _CONNECT_ARGS.items() if name not in url.query}


def _begin(connection: Connection) -> None:
    # Runs, uploads and answers all change the counts of a dataset, and what is active:
    # as on SQLite one transaction writes at a time, so none has to expect another.
    if connection.get_execution_options().get("writes", False):
        connection.exec_driver_sql(_BEGIN_WRITING)
