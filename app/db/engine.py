"""The database: its engine, sessions that read or write, and locks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from sqlalchemy import Connection, Engine, create_engine, event, func, make_url, select
from sqlalchemy.engine.interfaces import DBAPIConnection, ExceptionContext
from sqlalchemy.exc import DatabaseError, OperationalError
from sqlalchemy.orm import Session
from sqlalchemy.pool import ConnectionPoolEntry

from app.db.inspection import MOST_PROBLEMS, Ask, damaged_tables
from app.db.postgres import make_postgres_engine
from app.db.turns import Turns

BUSY_TIMEOUT_MS: Final = 30_000
KEPT_CONNECTIONS: Final = 16
MOST_CONNECTIONS: Final = 48
CACHE_KIB: Final = 4 * 1024
"""Page cache of each connection; all share the operating system's page cache."""
WRITER_CACHE_KIB: Final = 64 * 1024
"""Page cache of the connection that is writing, which holds the changed pages."""
WAL_PAGES: Final = 16_384
"""Pages in the write-ahead log at which a checkpoint is made: 64 MiB."""

STEPS_BETWEEN_CHECKS: Final = 100_000
"""Instructions of SQLite's virtual machine, some ms, between two calls of `stop`."""
_USE_READER_CACHE: Final = f"PRAGMA cache_size=-{CACHE_KIB}"
_USE_WRITER_CACHE: Final = f"PRAGMA cache_size=-{WRITER_CACHE_KIB}"
_HAS_WRITER_CACHE: Final = "has the cache of a writer"
_DAMAGED: Final = ("malformed", "is not a database")
_ONCE_COMMITTED: Final = "once committed"


def make_engine(url: str, turns: Turns | None = None) -> Engine:
    """An engine whose commits are durable when they return.

    Its transactions with the option ``writes`` take turns; those of a ``person`` first.
    """
    parsed = make_url(url)
    turns = turns or Turns()
    if parsed.get_backend_name() == "postgresql":
        return make_postgres_engine(parsed, turns=turns)
    # Errors quote their statement, but not its parameters, which contain users' data.
    engine = create_engine(
        parsed,
        pool_size=KEPT_CONNECTIONS,
        max_overflow=MOST_CONNECTIONS - KEPT_CONNECTIONS,
        hide_parameters=True,
    )
    event.listen(engine, "connect", _prepare_sqlite)
    turns.apply_to(engine)
    event.listen(engine, "begin", _begin_sqlite)
    event.listen(engine, "checkin", _shrink_cache)
    return engine


def _prepare_sqlite(connection: DBAPIConnection, _record: object) -> None:
    # Otherwise the driver begins transactions itself: deferred, before the first write.
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
    # A transaction that reads before it writes can fail at once with "database is
    # locked", regardless of the timeout: writers take the lock when they begin.
    if connection.get_execution_options().get("writes", False):
        connection.connection.cursor().execute(_USE_WRITER_CACHE)
        connection.info[_HAS_WRITER_CACHE] = True
        connection.exec_driver_sql("BEGIN IMMEDIATE")
        return
    # By the driver itself, which is faster: every request reads.
    driver = connection.connection.cursor()
    driver.execute("BEGIN")
    driver.close()


def _shrink_cache(
    connection: DBAPIConnection | None, record: ConnectionPoolEntry
) -> None:
    is_large = record.info.pop(_HAS_WRITER_CACHE, False)
    if is_large and connection is not None:  # None if the connection was lost
        connection.cursor().execute(_USE_READER_CACHE)


def once_committed(session: Session, call: Callable[[], None]) -> None:
    """Call `call` after a session of `Database.write` has been committed."""
    session.info.setdefault(_ONCE_COMMITTED, []).append(call)


def begin_as_work(session: Session) -> None:
    """Begin the transaction of a session of `Database.write` with low priority.

    For writes of many boxes, which may take long: single answers that wait are stored
    first. Call it before the first statement of the session.
    """
    session.connection(execution_options={"person": False})


class Database:
    """The database of one service."""

    def __init__(self, url: str) -> None:
        self.turns = Turns()
        self.engine = make_engine(url, self.turns)
        self.damage: str | None = None
        """SQLite's first error about damaged pages; None while there was none."""
        self.pages_checked = False
        if self.engine.dialect.name == "sqlite":
            event.listen(self.engine, "handle_error", self._note_damage)
        self._writer = self.engine.execution_options(writes=True)
        self._person = self._writer.execution_options(person=True)
        self._reader = self.engine
        if self.engine.dialect.name == "postgresql":
            self._reader = self.engine.execution_options(
                isolation_level="REPEATABLE READ"
            )

    @property
    def has_one_writer(self) -> bool:
        """Whether the whole database has one lock for writing (SQLite)."""
        return self.engine.dialect.name == "sqlite"

    @contextmanager
    def write(self, *, person: bool = False) -> Iterator[Session]:
        """A session that may write: committed at the end, rolled back on an exception.

        The transaction begins with the first statement, which waits for its turn; work
        done before that holds no lock. Set `person` if a person waits for the result:
        such transactions come before others.
        """
        bind = self._person if person else self._writer
        with (
            Session(bind, expire_on_commit=False, autoflush=False) as session,
            session.begin(),
        ):
            yield session
        for call in session.info.get(_ONCE_COMMITTED, ()):
            call()

    @contextmanager
    def write_out_of_turn(self) -> Iterator[Session]:
        """As `write`, for rows that no other transaction uses.

        On PostgreSQL it does not wait for its turn. On SQLite it does, as only one
        transaction can write there.
        """
        if self.has_one_writer:
            with self.write() as session:
                yield session
            return
        with Session(self.engine, expire_on_commit=False) as session, session.begin():
            yield session

    @contextmanager
    def read(self) -> Iterator[Session]:
        """A session that reads one consistent snapshot."""
        with Session(self._reader, expire_on_commit=False, autoflush=False) as session:
            yield session

    def check_pages(self, stop: Callable[[], bool]) -> bool:
        """Check all pages of SQLite's file; False if `stop` ended it early.

        If pages are damaged, `damage` is set.
        """
        with self.engine.connect() as connection:
            driver = connection.connection
            driver.set_progress_handler(stop, STEPS_BETWEEN_CHECKS)

            def ask(text: str) -> list[tuple[object, ...]]:
                return [tuple(row) for row in connection.exec_driver_sql(text)]

            try:
                damage = self._first_damage(ask)
                tables = damaged_tables(ask)[:MOST_PROBLEMS] if damage else []
            except OperationalError as exc:
                if "interrupted" in str(exc.orig):
                    return False
                raise
            except DatabaseError:  # `_note_damage` was called for it
                if self.damage is None:
                    raise
                return True
            finally:
                driver.set_progress_handler(None, 0)
        self.damage = "; ".join(tables) or damage or self.damage
        self.pages_checked = True
        return True

    def _first_damage(self, ask: Ask) -> str:
        """SQLite's first error; empty if all pages are intact."""
        try:
            ((result,),) = ask("PRAGMA quick_check(1)")
        except DatabaseError:
            if self.damage is None:
                raise
            return self.damage
        return "" if result == "ok" else str(result).replace("\n", " ")

    def _note_damage(self, context: ExceptionContext) -> None:
        text = str(context.original_exception)
        if any(words in text for words in _DAMAGED):
            self.damage = self.damage or text

    def checkpoint(self) -> None:
        """Copy SQLite's write-ahead log into the database file, so that it restarts."""
        if self.file is None:
            return
        with self.engine.connect() as connection:
            # The transaction has not read yet, so it does not stand in the way.
            connection.exec_driver_sql("PRAGMA wal_checkpoint(PASSIVE)")

    @property
    def file(self) -> Path | None:
        """The file of the database; None on PostgreSQL."""
        name = self.engine.url.database
        return Path(name) if name and self.engine.dialect.name == "sqlite" else None

    def close(self) -> None:
        self.engine.dispose()


_MIGRATION: Final = (
    0x756E67686F7374  # "unghost" in ASCII; must differ from the keys of other locks
)


@contextmanager
def migrating_alone(engine: Engine) -> Iterator[None]:
    """Hold a lock in the block, so that only one process migrates at a time.

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
    """Disable the idle timeout of this transaction.

    For a transaction that removes files: if PostgreSQL ended it as idle, another
    transaction could add references to these files.
    """
    if session.connection().dialect.name == "postgresql":
        named = "idle_in_transaction_session_timeout"
        session.execute(select(func.set_config(named, "0", True)))
