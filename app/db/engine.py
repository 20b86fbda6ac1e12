"""Opening the database: one engine, sessions that read and write, and locks."""

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
"""Of each connection. What it has not, the system has: a cache that all share."""
WRITER_CACHE_KIB: Final = 64 * 1024
"""Of the one that writes, for as long as it does: changes are put into order there."""
WAL_PAGES: Final = 16_384
"""Pages in the write-ahead log before it is folded back: 64 MiB."""

STEPS_BETWEEN_LOOKS: Final = 100_000
"""Of SQLite's machine: some milliseconds."""
_CACHE_OF_A_READER: Final = f"PRAGMA cache_size=-{CACHE_KIB}"
_CACHE_OF_THE_WRITER: Final = f"PRAGMA cache_size=-{WRITER_CACHE_KIB}"
_HAS_MUCH: Final = "has the cache of a writer"
_DAMAGED: Final = ("malformed", "is not a database")
_ONCE_COMMITTED: Final = "once committed"


def sqlite_url(path: Path) -> str:
    """The URL of a database file."""
    return f"sqlite:///{path}"


def make_engine(url: str, turns: Turns | None = None) -> Engine:
    """An engine whose commits are durable when they return.

    Its transactions with the option ``writes`` take turns; those of a ``person`` first.
    """
    parsed = make_url(url)
    turns = turns or Turns()
    if parsed.get_backend_name() == "postgresql":
        return make_postgres_engine(parsed, turns=turns)
    # Errors name their statement, and what people wrote is no part of it.
    engine = create_engine(
        parsed,
        pool_size=KEPT_CONNECTIONS,
        max_overflow=MOST_CONNECTIONS - KEPT_CONNECTIONS,
        hide_parameters=True,
    )
    event.listen(engine, "connect", _prepare_sqlite)
    turns.rule(engine)
    event.listen(engine, "begin", _begin_sqlite)
    event.listen(engine, "checkin", _keep_little)
    return engine


def _prepare_sqlite(connection: DBAPIConnection, _record: object) -> None:
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
        connection.connection.cursor().execute(_CACHE_OF_THE_WRITER)
        connection.info[_HAS_MUCH] = True
        connection.exec_driver_sql("BEGIN IMMEDIATE")
        return
    # Every request reads, and this cannot fail: not worth SQLAlchemy's way round.
    driver = connection.connection.cursor()
    driver.execute("BEGIN")
    driver.close()


def _keep_little(
    connection: DBAPIConnection | None, record: ConnectionPoolEntry
) -> None:
    has_much = record.info.pop(_HAS_MUCH, False)
    if has_much and connection is not None:  # else it was lost
        connection.cursor().execute(_CACHE_OF_A_READER)


def once_committed(session: Session, tell: Callable[[], None]) -> None:
    """Call this once a session of `Database.write` is committed; never if it fails."""
    session.info.setdefault(_ONCE_COMMITTED, []).append(tell)


def begin_as_work(session: Session) -> None:
    """Begin the transaction of a session of `Database.write` as work, not as a person.

    For acts on many boxes, which may take long: single answers that wait are stored
    before them. To be called before its first statement.
    """
    session.connection(execution_options={"person": False})


class Database:
    """The database of one service."""

    def __init__(self, url: str) -> None:
        self.turns = Turns()
        self.engine = make_engine(url, self.turns)
        self.damage: str | None = None
        """What SQLite said of pages that it cannot read, from the first time on."""
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
        """Whether nothing at all can be stored while another transaction writes."""
        return self.engine.dialect.name == "sqlite"

    @contextmanager
    def write(self, *, person: bool = False) -> Iterator[Session]:
        """A session that may write: it commits on leaving, or leaves no trace.

        The transaction begins with the first statement, so work done before that
        holds no lock. It waits for its turn then; what a `person` waits for comes
        before other work.
        """
        bind = self._person if person else self._writer
        with (
            Session(bind, expire_on_commit=False, autoflush=False) as session,
            session.begin(),
        ):
            yield session
        for tell in session.info.get(_ONCE_COMMITTED, ()):
            tell()

    @contextmanager
    def write_beside(self) -> Iterator[Session]:
        """As `write`, for rows that concern no other transaction.

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
        """A session for reading one consistent state."""
        with Session(self._reader, expire_on_commit=False, autoflush=False) as session:
            yield session

    def check_pages(self, stop: Callable[[], bool]) -> bool:
        """Look at all pages of SQLite; False if it was told to stop before the end.

        What is wrong with them is in `damage` afterwards.
        """
        with self.engine.connect() as connection:
            driver = connection.connection
            driver.set_progress_handler(stop, STEPS_BETWEEN_LOOKS)

            def ask(text: str) -> list[tuple[object, ...]]:
                return [tuple(row) for row in connection.exec_driver_sql(text)]

            try:
                found = self._first_damage(ask)
                tables = damaged_tables(ask)[:MOST_PROBLEMS] if found else []
            except OperationalError as exc:
                if "interrupted" in str(exc.orig):
                    return False
                raise
            except DatabaseError:  # noted already, as damage or not
                if self.damage is None:
                    raise
                return True
            finally:
                driver.set_progress_handler(None, 0)
        self.damage = "; ".join(tables) or found or self.damage
        self.pages_checked = True
        return True

    def _first_damage(self, ask: Ask) -> str:
        """In SQLite's words; empty if all pages are whole."""
        try:
            ((found,),) = ask("PRAGMA quick_check(1)")
        except DatabaseError:
            if self.damage is None:
                raise
            return self.damage
        return "" if found == "ok" else str(found).replace("\n", " ")

    def _note_damage(self, context: ExceptionContext) -> None:
        text = str(context.original_exception)
        if any(words in text for words in _DAMAGED):
            self.damage = self.damage or text

    def fold_log(self) -> None:
        """Write what is in SQLite's log to its place, so that the log begins anew."""
        if self.file is None:
            return
        with self.engine.connect() as connection:
            driver = connection.connection.dbapi_connection
            if driver is not None:
                driver.cursor().execute("PRAGMA wal_checkpoint(PASSIVE)")

    @property
    def file(self) -> Path | None:
        """Where it lies, if it is a file."""
        name = self.engine.url.database
        return Path(name) if name and self.engine.dialect.name == "sqlite" else None

    def close(self) -> None:
        """Give back all connections."""
        self.engine.dispose()


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
    """Let this transaction stay open without a statement for as long as it takes.

    For a writer that removes files in its turn. If PostgreSQL ended the transaction
    meanwhile, another one could refer to these files.
    """
    if session.connection().dialect.name == "postgresql":
        named = "idle_in_transaction_session_timeout"
        session.execute(select(func.set_config(named, "0", True)))
