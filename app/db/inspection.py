"""Examines databases without changing them, and copies one that is in use."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final

import sqlalchemy as sa
from sqlalchemy import Engine, create_engine, event, inspect, make_url
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

    Raises sqlite3.DatabaseError if it cannot be read at all.
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
        rows = database.execute(
            "SELECT name, sql FROM sqlite_master WHERE type = 'trigger'"
        )
        return [str(name) for name, sql in rows if sql not in _TRIGGERS]


def missing_triggers(engine: Engine) -> list[str]:
    """For each missing or altered trigger, the statements that make it again."""
    with engine.connect() as connection:
        if engine.dialect.name == "sqlite":
            rows = connection.exec_driver_sql(
                "SELECT sql FROM sqlite_master WHERE type = 'trigger'"
            )
            missing = sorted(_TRIGGERS - {str(row[0]) for row in rows})
            names = [trigger.split()[2] for trigger in missing]
            pairs = zip(names, missing, strict=True)
            return [f"DROP TRIGGER IF EXISTS {name}; {text}" for name, text in pairs]
        if connection.exec_driver_sql(_IS_REFUSING.replace("%", "%%")).scalar_one():
            return []
    name = _SERVER_TRIGGER.split()[2]
    return [f"DROP TRIGGER IF EXISTS {name} ON audit_log; {_SERVER_TRIGGER}"]


def referenced_files(file: Path) -> set[str]:
    """Digests of all blobs that a SQLite file of any schema version refers to.

    The file may be from somebody else. A view in place of a table can compute rows
    without end, and a column can be computed, too: then, or if it cannot be read,
    sqlite3.DatabaseError is raised.
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
                problems = list(_problems(ask))
            except DBAPIError as exc:
                problems = [str(exc.orig)]
            return [*damaged_tables(ask), *problems] if problems else []
    except DBAPIError as exc:
        return [str(exc.orig)]


def damaged_tables(ask: Ask) -> list[str]:
    """The tables of a SQLite database that cannot be read completely, and why not.

    Raises what `ask` does if not even the list of tables can be read, or if the check
    was interrupted.
    """
    if sqlite3.sqlite_version_info < _CHECKS_TABLES:
        return []
    damaged = []
    tables = ask("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
    for (table,) in tables:
        try:
            rows = ask(f'PRAGMA quick_check("{table}")')
            lines = "\n".join(str(text) for (text,) in rows).splitlines()
        except (sqlite3.DatabaseError, DBAPIError) as exc:
            if "interrupted" in str(exc):
                raise
            lines = [str(exc.orig if isinstance(exc, DBAPIError) else exc)]
        if lines != ["ok"]:
            # Pages that are only unreachable are a consequence of the damaged one.
            lines.sort(key=lambda line: any(word in line for word in _CONSEQUENCES))
            damaged.append(f"table {table} or an index of it: {lines[0]}")
    return damaged


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
        mode = "mode=rw"
        try:
            with closing(sqlite3.connect(_uri(file, "rw"), uri=True)) as opened:
                opened.execute("SELECT count(*) FROM sqlite_master").fetchone()
        except sqlite3.OperationalError:
            mode = "mode=ro&immutable=1"
        except sqlite3.DatabaseError:
            pass  # it is damaged, which later reads report
        engine = create_engine(f"sqlite:///file:{_quoted(file)}?{mode}&uri=true")

        def set_read_only(connection: sqlite3.Connection, _record: object) -> None:
            connection.execute("PRAGMA query_only=ON")
            connection.execute("PRAGMA busy_timeout=30000")

        event.listen(engine, "connect", set_read_only)
    try:
        yield engine
    finally:
        engine.dispose()


def _uri(file: Path, mode: str) -> str:
    return f"file:{_quoted(file)}?mode={mode}"


def _quoted(file: Path) -> str:
    return file.resolve().as_posix().replace("%", "%25").replace("?", "%3f")


_DURABLE: Final = ("fsync", "full_page_writes", "synchronous_commit")


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
        values = {
            name: connection.exec_driver_sql(f"SHOW {name}").scalar_one()
            for name in _DURABLE
        }
    return [f"{name} = off" for name, value in values.items() if value == "off"]


def broken_keys(engine: Engine) -> list[str]:
    """Rows that refer to missing rows, and missing foreign keys.

    PostgreSQL enforces foreign keys, unless that was turned off or a restore failed.
    """
    names, orphans = set(), []
    with engine.connect() as connection:
        inspector = inspect(connection)
        for table in sorted(inspector.get_table_names()):
            for key in inspector.get_foreign_keys(table):
                (column,), (referred,) = (
                    key["constrained_columns"],
                    key["referred_columns"],
                )
                child = sa.table(table, sa.column(column)).alias()
                parent = sa.table(key["referred_table"], sa.column(referred)).alias()
                value = child.c[column]
                has_parent = sa.exists().where(parent.c[referred] == value)
                lost = sa.select(sa.func.count()).select_from(child)
                rows = connection.scalar(lost.where(value.is_not(None), ~has_parent))
                if rows:
                    orphans.append(
                        f"{rows} rows of {table} have no parent in "
                        f"{key['referred_table']}"
                    )
                names.add(key["name"] or "")
    missing = [
        f"{table.name} has no key {name}"
        for table in Base.metadata.sorted_tables
        for name in sorted(str(key.name) for key in table.foreign_key_constraints)
        if name not in names
    ]
    return [*missing, *orphans]
