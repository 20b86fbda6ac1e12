"""Looking at a database on a PostgreSQL server without changing it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

from sqlalchemy import Connection, Engine, inspect
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from app.db.base import Base

_DURABLE: Final = ("fsync", "full_page_writes", "synchronous_commit")


class ForeignKey(NamedTuple):
    """A column whose values are those of another table's column."""

    name: str
    table: str
    column: str
    parent: str
    parent_column: str


def silence_of(engine: Engine) -> str:
    """Why a database does not answer; empty if it does. It names no password."""
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
    """Settings of the server with which a power cut may take what was answered."""
    with engine.connect() as connection:
        found = {
            name: connection.exec_driver_sql(f"SHOW {name}").scalar_one()
            for name in _DURABLE
        }
    return [f"{name} = off" for name, value in found.items() if value == "off"]


def broken_keys(engine: Engine) -> list[str]:
    """Rows without the rows they belong to, and keys that nobody keeps any more.

    PostgreSQL keeps keys itself, unless it was told not to, or a restore stopped early.
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
        rows = connection.exec_driver_sql(
            f"SELECT count(*) FROM {key.table} child WHERE {key.column} IS NOT NULL "
            f"AND NOT EXISTS (SELECT FROM {key.parent} parent "
            f"WHERE parent.{key.parent_column} = child.{key.column})"
        ).scalar_one()
        if rows:
            yield f"{rows} rows of {key.table} have no parent in {key.parent}"
