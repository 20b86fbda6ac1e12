"""Many rows at once, without the cost that the ORM and Core add to each of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import islice
from typing import Any, Final, cast

from sqlalchemy import Dialect, Insert, Table, insert
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session
from sqlalchemy.sql.dml import UpdateBase

from app.db.base import Base

MAX_PARAMETERS: Final = 10_000


def execute_many(
    session: Session, statement: UpdateBase, columns: Mapping[str, Sequence[Any]]
) -> None:
    """Run an insert or update once per row of `columns`, named as its parameters.

    The statement is compiled once and goes to the driver with plain tuples: Core builds
    a dictionary per row and costs four times as much at a million rows.
    """
    if not columns or not len(next(iter(columns.values()))):
        return
    connection = session.connection()
    compiled = statement.compile(dialect=connection.dialect)
    rows: list[Any]
    if compiled.positional:
        order = compiled.positiontup or []
        rows = list(zip(*(columns[name] for name in order), strict=True))
    else:
        names = list(columns)
        rows = [
            dict(zip(names, row, strict=True))
            for row in zip(*columns.values(), strict=True)
        ]
    connection.exec_driver_sql(str(compiled), rows)


def chunks(ids: Iterable[int]) -> Iterator[list[int]]:
    """Ids in portions that fit the number of parameters a statement may have."""
    source = iter(ids)
    while portion := list(islice(source, MAX_PARAMETERS)):
        yield portion


def insert_rows(
    session: Session, model: type[Base], rows: Sequence[Mapping[str, Any]]
) -> None:
    """Insert rows as they are, past the ORM."""
    if rows:
        session.connection().execute(_insert(model), list(rows))


def insert_plain(
    session: Session, model: type[Base], rows: Sequence[Mapping[str, Any]]
) -> None:
    """Insert rows of numbers and text, which the driver takes as they are.

    All of them have the columns of the first. Times and JSON are not plain: they go
    through `insert_rows`, which costs twice as much.
    """
    if not rows:
        return
    connection = session.connection()
    text, order = _plain_insert(model, frozenset(rows[0]), connection.dialect)
    if order:
        tuples = [tuple(row[name] for name in order) for row in rows]
        connection.exec_driver_sql(text, tuples)
    else:
        connection.exec_driver_sql(text, [dict(row) for row in rows])


def upsert(session: Session, model: type[Base]) -> Any:  # noqa: ANN401  # of either dialect
    """An insert that can say ``on_conflict_do_...``, for the database at hand."""
    return upsert_in(session.connection().dialect.name, model)


def upsert_in(dialect: str, model: type[Base]) -> Any:  # noqa: ANN401  # of either dialect
    """As `upsert`, by the dialect's name: for statements that are built once."""
    if dialect == "postgresql":
        return postgresql.insert(_table(model))
    return sqlite.insert(_table(model))


@lru_cache
def _insert(model: type[Base]) -> Insert:
    return insert(_table(model))


@lru_cache
def _plain_insert(
    model: type[Base], columns: frozenset[str], dialect: Dialect
) -> tuple[str, tuple[str, ...]]:
    """The statement, and its parameters in order if the driver takes them by place."""
    compiled = _insert(model).compile(dialect=dialect, column_keys=sorted(columns))
    return str(compiled), tuple(compiled.positiontup or ())


def _table(model: type[Base]) -> Table:
    return cast("Table", model.__table__)
