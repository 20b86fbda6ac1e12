"""Examines databases without changing them, and copies one that is in use."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final, NamedTuple

import sqlalchemy as sa
from sqlalchemy import Connection, Engine, create_engine, event, inspect, make_url
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from app.db.base import Base
from app.db.postgres import make_postgres_engine

PAGES_AT_A_TIME: Final = 4096
"""A copy reports its progress after each 16 MiB."""
MOST_PROBLEMS: Final = 20
_REFERENCED: Final = (
    "SELECT sha256 FROM frame_files",
    "SELECT sha256 FROM exports WHERE state = 'done' AND sha256 IS NOT NULL",
)
_ARE_TABLES: Final = (
    "SELECT type = 'table' AND sql NOT LIKE 'CREATE VIRTUAL%' FROM sqlite_master "
    "WHERE lower(name) IN ('frame_files', 'exports')"
)
_TRIGGERS: Final = frozenset(
    f"CREATE TRIGGER audit_log_no_{event.lower()} BEFORE {event} ON audit_log "
    "BEGIN SELECT RAISE(ABORT, 'the audit log is only added to'); END"
    for event in ("UPDATE", "DELETE")
)
"""The SQL of the triggers that the migrations make in SQLite."""
_SERVER_TRIGGER: Final = (
    "CREATE TRIGGER audit_log_no_change BEFORE UPDATE OR DELETE ON audit_log "
    "FOR EACH ROW EXECUTE FUNCTION audit_log_refuse()"
)
"""The same in PostgreSQL."""
_IS_REFUSING: Final = (
    "SELECT count(*) FROM pg_trigger JOIN pg_proc ON pg_proc.oid = tgfoid "
    "WHERE tgrelid = 'audit_log'::regclass AND tgname = 'audit_log_no_change' "
    "AND tgenabled IN ('O', 'A') AND prosrc LIKE '%RAISE EXCEPTION%'"
)
_DIGEST: Final = re.compile(r"[0-9a-f]{64}")
_MEMORY: Final = ("", ":memory:")

_CHECKS_TABLES: Final = (3, 33)
"""SQLite can check a single table from this version on."""
_CONSEQUENCES: Final = ("***", "is never used")
"""Parts of messages about pages that are only unreachable because of a damaged one."""

Ask = Callable[[str], "list[tuple[object, ...]]"]
"""Runs a statement and returns its rows."""
Advance = Callable[[int, "int | None"], None]


def sqlite_file(url: str) -> Path | None:
    """The file of a SQLite database; None for a database on a server."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite" or (parsed.database or "") in _MEMORY:
        return None
    return Path(parsed.database or "")


def copy_database(source: Path, target: Path, advance: Advance) -> None:
    """Copy a snapshot of a SQLite database while others may write to it.

    The copy is a single file, without a write-ahead log.
    """
    with (
        closing(sqlite3.connect(_uri(source, "rw"), uri=True)) as database,
        closing(sqlite3.connect(target)) as copy,
    ):
        database.isolation_level = None
        database.execute("PRAGMA busy_timeout=30000")
        # One transaction for the whole copy: otherwise each commit would restart it.
        database.execute("BEGIN")
        database.execute("SELECT count(*) FROM sqlite_master").fetchone()
        database.backup(
            copy,
            pages=PAGES_AT_A_TIME,
            progress=lambda _status, left, total: advance(total - left, total),
            sleep=0,
        )
        copy.execute("PRAGMA journal_mode=DELETE")


def problems_of(file: Path) -> list[str]:
    """Faults of a SQLite file that no other process uses; empty if there are none.

    Raises
    ------
    sqlite3.DatabaseError
        It cannot be read at all.
    """
    with closing(sqlite3.connect(_uri(file, "ro"), uri=True)) as database:
        return list(_problems(lambda text: database.execute(text).fetchall()))


def revision_of(file: Path) -> str | None:
    """The schema revision of a SQLite file that no other process uses, or None."""
    with closing(sqlite3.connect(_uri(file, "ro"), uri=True)) as database:
        try:
            row = database.execute("SELECT version_num FROM alembic_version").fetchone()
        except sqlite3.OperationalError:
            return None
    return None if row is None else str(row[0])


def foreign_triggers(file: Path) -> list[str]:
    """The names of triggers in a SQLite file that no migration has made."""
    with closing(sqlite3.connect(_uri(file, "ro"), uri=True)) as database:
        found = database.execute(
            "SELECT name, sql FROM sqlite_master WHERE type = 'trigger'"
        )
        return [str(name) for name, sql in found if sql not in _TRIGGERS]


def missing_triggers(engine: Engine) -> list[str]:
    """For each missing or altered trigger, the statements that make it again."""
    with engine.connect() as connection:
        if engine.dialect.name == "sqlite":
            rows = connection.exec_driver_sql(
                "SELECT sql FROM sqlite_master WHERE type = 'trigger'"
            )
            missing = sorted(_TRIGGERS - {str(row[0]) for row in rows})
            return [f"DROP TRIGGER IF EXISTS {_name(one)}; {one}" for one in missing]
        if connection.exec_driver_sql(_IS_REFUSING.replace("%", "%%")).scalar_one():
            return []
    name = _name(_SERVER_TRIGGER)
    return [f"DROP TRIGGER IF EXISTS {name} ON audit_log; {_SERVER_TRIGGER}"]


def _name(trigger: str) -> str:
    return trigger.split()[2]


def referenced_files(file: Path) -> set[str]:
    """Digests of all blobs that a SQLite file of any schema version refers to.

    The file may be from somebody else. A view in place of a table can compute rows
    without end, and a column can be computed, too.

    Raises
    ------
    sqlite3.DatabaseError
        It cannot be read, or computes what should be stored.
    """
    digests = set[str]()
    with closing(sqlite3.connect(_uri(file, "ro"), uri=True)) as database:
        if database.execute(_ARE_TABLES).fetchall() != [(1,), (1,)]:
            raise sqlite3.DatabaseError("frame_files or exports is no table")
        for statement in _REFERENCED:
            for (digest,) in database.execute(statement):
                if not (isinstance(digest, str) and _DIGEST.fullmatch(digest)):
                    raise sqlite3.DatabaseError("a file has no SHA-256")
                digests.add(digest)
    return digests


def problems_in(engine: Engine) -> list[str]:
    """Faults of a SQLite database in use; damaged tables come first."""
    try:
        with engine.connect() as connection:

            def ask(text: str) -> list[tuple[object, ...]]:
                return [tuple(row) for row in connection.exec_driver_sql(text)]

            try:
                found = list(_problems(ask))
            except DBAPIError as exc:
                found = [str(exc.orig)]
            return [*damaged_tables(ask), *found] if found else []
    except DBAPIError as exc:
        return [str(exc.orig)]


def damaged_tables(ask: Ask) -> list[str]:
    """The tables of a SQLite database that cannot be read completely, and why not.

    Raises
    ------
    sqlite3.DatabaseError or DBAPIError, as `ask` does
        Not even the list of tables can be read, or the check was interrupted.
    """
    if sqlite3.sqlite_version_info < _CHECKS_TABLES:
        return []
    tables = ask("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
    checked = ((name, _first_problem(ask, str(name))) for (name,) in tables)
    return [f"table {name} or an index of it: {why}" for name, why in checked if why]


def _first_problem(ask: Ask, table: str) -> str:
    try:
        rows = ask(f'PRAGMA quick_check("{table}")')
    except (sqlite3.DatabaseError, DBAPIError) as exc:
        if "interrupted" in str(exc):
            raise
        return str(exc.orig if isinstance(exc, DBAPIError) else exc)
    lines = "\n".join(str(text) for (text,) in rows).splitlines()
    causes = [line for line in lines if not any(word in line for word in _CONSEQUENCES)]
    return "" if lines == ["ok"] else (causes or lines)[0]


def _problems(ask: Ask) -> Iterator[str]:
    for (text,) in ask(f"PRAGMA integrity_check({MOST_PROBLEMS})"):
        if text != "ok":
            yield str(text)
    orphans = ask("PRAGMA foreign_key_check")
    for table, row, parent, _ in orphans[:MOST_PROBLEMS]:
        yield f"row {row} of {table} has no parent in {parent}"


@contextmanager
def read_only_engine(database: str | Path) -> Iterator[Engine]:
    """A read-only engine of a URL or of a SQLite file; it creates no database.

    On a read-only file system, a SQLite file is read without its write-ahead log.
    """
    file = database if isinstance(database, Path) else sqlite_file(database)
    if file is None:
        engine = make_postgres_engine(make_url(str(database)), only_read=True)
    else:
        mode = "mode=rw" if _opens(file) else "mode=ro&immutable=1"
        engine = create_engine(f"sqlite:///file:{_quoted(file)}?{mode}&uri=true")
        event.listen(engine, "connect", _set_read_only)
    try:
        yield engine
    finally:
        engine.dispose()


def _opens(file: Path) -> bool:
    try:
        with closing(sqlite3.connect(_uri(file, "rw"), uri=True)) as database:
            database.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.OperationalError:
        return False
    except sqlite3.DatabaseError:
        return True  # it is damaged, which later reads report
    return True


def _set_read_only(connection: sqlite3.Connection, _record: object) -> None:
    connection.execute("PRAGMA query_only=ON")
    connection.execute("PRAGMA busy_timeout=30000")


def _uri(file: Path, mode: str) -> str:
    return f"file:{_quoted(file)}?mode={mode}"


def _quoted(file: Path) -> str:
    return file.resolve().as_posix().replace("%", "%25").replace("?", "%3f")


_DURABLE: Final = ("fsync", "full_page_writes", "synchronous_commit")


class ForeignKey(NamedTuple):
    """A column whose values are those of another table's column."""

    name: str
    table: str
    column: str
    parent: str
    parent_column: str


def connection_fault(engine: Engine) -> str:
    """Why a database does not respond; empty if it does. It contains no password."""
    try:
        with engine.connect() as connection:
            connection.exec_driver_sql("SELECT 1")
    except DBAPIError as exc:
        return " ".join(str(exc.orig).split())
    except SQLAlchemyError as exc:
        return type(exc).__name__
    return ""


def version_of(engine: Engine) -> str:
    """The server's own version."""
    with engine.connect() as connection:
        return str(connection.exec_driver_sql("SHOW server_version").scalar_one())


def not_durable(engine: Engine) -> list[str]:
    """Settings of the server by which a power failure may lose committed data."""
    with engine.connect() as connection:
        found = {
            name: connection.exec_driver_sql(f"SHOW {name}").scalar_one()
            for name in _DURABLE
        }
    return [f"{name} = off" for name, value in found.items() if value == "off"]


def broken_keys(engine: Engine) -> list[str]:
    """Rows that refer to missing rows, and missing foreign keys.

    PostgreSQL enforces foreign keys, unless that was turned off or a restore failed.
    """
    with engine.connect() as connection:
        there = list(_keys(connection))
        return [*_missing({key.name for key in there}), *_orphans(connection, there)]


def _keys(connection: Connection) -> Iterator[ForeignKey]:
    inspector = inspect(connection)
    for table in sorted(inspector.get_table_names()):
        for key in inspector.get_foreign_keys(table):
            (column,), (parent,) = key["constrained_columns"], key["referred_columns"]
            name = key["name"] or ""
            yield ForeignKey(name, table, column, key["referred_table"], parent)


def _missing(there: set[str]) -> Iterator[str]:
    for table in Base.metadata.sorted_tables:
        for key in sorted(table.foreign_key_constraints, key=lambda one: str(one.name)):
            if str(key.name) not in there:
                yield f"{table.name} has no key {key.name}"


def _orphans(connection: Connection, keys: list[ForeignKey]) -> Iterator[str]:
    for key in keys:
        child = sa.table(key.table, sa.column(key.column)).alias()
        parent = sa.table(key.parent, sa.column(key.parent_column)).alias()
        value = child.c[key.column]
        has_parent = sa.exists().where(parent.c[key.parent_column] == value)
        rows = connection.scalar(
            sa.select(sa.func.count())
            .select_from(child)
            .where(value.is_not(None), ~has_parent)
        )
        if rows:
            yield f"{rows} rows of {key.table} have no parent in {key.parent}"
