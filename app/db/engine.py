"""Opening the database: one engine, read and write sessions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from sqlalchemy import Connection, Engine, create_engine, event, make_url
from sqlalchemy.orm import Session

from app.db.postgres import make_postgres_engine

BUSY_TIMEOUT_MS: Final = 30_000
CACHE_KIB: Final = 256 * 1024
STREAM_CACHE_KIB: Final = 8 * 1024
WAL_PAGES: Final = 16_384
"""Pages in the write-ahead log before it is folded back: 64 MiB."""

_ONCE_COMMITTED: Final = "once committed"


def sqlite_url(path: Path) -> str:
    """The URL of a database file."""
    return f"sqlite:///{path}"


def make_engine(url: str) -> Engine:
    """An engine whose commits are durable when they return."""
    parsed = make_url(url)
    if parsed.get_backend_name() == "postgresql":
        return make_postgres_engine(parsed)
    # Errors name their statement, and what people wrote is no part of it.
    engine = create_engine(parsed, pool_size=16, max_overflow=32, hide_parameters=True)
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_sqlite(connection: Any, _record: object) -> None:  # noqa: ANN401  # any DB-API connection
    # The driver's own transaction handling begins too late and too weakly.
    connection.isolation_level = None
    for pragma in (
        "journal_mode=WAL",
        "synchronous=FULL",
        f"busy_timeout={BUSY_TIMEOUT_MS}",
        "foreign_keys=ON",
        f"cache_size=-{CACHE_KIB}",
        f"wal_autocheckpoint={WAL_PAGES}",
        "temp_store=MEMORY",
    ):
        connection.execute(f"PRAGMA {pragma}").close()


def _begin_sqlite(connection: Connection) -> None:
    # A transaction that starts by reading and writes later can fail at once with
    # "database is locked", whatever the time-out: writers take their place first.
    if connection.get_execution_options().get("writes", False):
        connection.exec_driver_sql("BEGIN IMMEDIATE")
        return
    # Every request reads, and this cannot fail: not worth SQLAlchemy's way round.
    driver = connection.connection.cursor()
    driver.execute("BEGIN")
    driver.close()


def once_committed(session: Session, tell: Callable[[], None]) -> None:
    """Call this once a session of `Database.write` is committed; never if it fails."""
    session.info.setdefault(_ONCE_COMMITTED, []).append(tell)


class Database:
    """The database of one service."""

    def __init__(self, url: str) -> None:
        self.engine = make_engine(url)
        self._writer = self.engine.execution_options(writes=True)
        self._reader = self.engine
        if self.engine.dialect.name == "postgresql":
            self._reader = self.engine.execution_options(
                isolation_level="REPEATABLE READ"
            )

    @property
    def has_one_writer(self) -> bool:
        """Whether nothing at all can be stored while another transaction writes."""
        return self.engine.dialect.name == "sqlite"

    @contextmanager
    def write(self) -> Iterator[Session]:
        """A session that may write: it commits on leaving, or leaves no trace.

        The transaction begins with the first statement, so work done before that
        holds no lock.
        """
        with (
            Session(self._writer, expire_on_commit=False, autoflush=False) as session,
            session.begin(),
        ):
            yield session
        for tell in session.info.get(_ONCE_COMMITTED, ()):
            tell()

    @contextmanager
    def write_beside(self) -> Iterator[Session]:
        """As `write`, for rows that no other transaction counts on.

        On PostgreSQL it does not wait for its turn behind other writers; SQLite has
        only one place for a writer.
        """
        if self.has_one_writer:
            with self.write() as session:
                yield session
            return
        with Session(self.engine, expire_on_commit=False) as session, session.begin():
            yield session

    @contextmanager
    def read(self) -> Iterator[Session]:
        """A session for reading one consistent state."""
        with Session(self._reader, expire_on_commit=False, autoflush=False) as session:
            yield session

    @contextmanager
    def stream(self) -> Iterator[Session]:
        """As `read`, for reading very much once: it is not kept in memory."""
        with self.read() as session:
            if self.engine.dialect.name != "sqlite":
                yield session
                return
            connection = session.connection()
            connection.exec_driver_sql(f"PRAGMA cache_size=-{STREAM_CACHE_KIB}")
            try:
                yield session
            finally:
                connection.exec_driver_sql(f"PRAGMA cache_size=-{CACHE_KIB}")

    @property
    def file(self) -> Path | None:
        """Where it lies, if it is a file."""
        name = self.engine.url.database
        return Path(name) if name and self.engine.dialect.name == "sqlite" else None

    def close(self) -> None:
        """Give back all connections."""
        self.engine.dispose()
