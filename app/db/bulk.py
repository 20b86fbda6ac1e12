"""Statements on many rows, without SQLAlchemy's overhead for each row."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from operator import itemgetter
from typing import TYPE_CHECKING, Final, TypeAlias, TypeVar, cast, overload

from sqlalchemy import (
    ARRAY,
    Boolean,
    Connection,
    CursorResult,
    Dialect,
    Engine,
    Executable,
    Insert,
    Table,
    Update,
    bindparam,
    column,
    func,
    insert,
    update,
)
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session
from sqlalchemy.sql.dml import UpdateBase

from app.db.base import Base

if TYPE_CHECKING:
    from sqlalchemy.sql import ClauseElement
    from sqlalchemy.sql.compiler import SQLCompiler
    from sqlalchemy.sql.selectable import TypedReturnsRows
    from sqlalchemy.util.typing import TypeVarTuple, Unpack

    _Columns = TypeVarTuple("_Columns")

_Item = TypeVar("_Item")

MAX_PARAMETERS: Final = 10_000
COPY_FROM_ROWS: Final = 2
"""COPY is used from this many rows on: see benchmarks/bench_postgres.py."""
ROWS_AT_A_TIME: Final = 10_000
"""Rows per statement: some tens of milliseconds, after which `written` is called."""
DialectInsert: TypeAlias = postgresql.Insert | sqlite.Insert
"""An INSERT of either dialect, with ``on_conflict_do_...``."""
Written = Callable[[int], None]
"""Called with the number of rows that were just written; it may raise to stop."""


def execute_many(
    session: Session,
    statement: UpdateBase,
    columns: Mapping[str, Sequence[object]],
    written: Written | None = None,
) -> None:
    """Execute an insert or update once per row of `columns`, named as its parameters.

    The statement is compiled once and goes to the driver with plain tuples: Core builds
    a dictionary per row and costs four times as much at a million rows.
    """
    if not columns or not len(next(iter(columns.values()))):
        return
    connection = session.connection()
    compiled = statement.compile(dialect=connection.dialect)
    rows: Sequence[tuple[object, ...] | dict[str, object]]
    if compiled.positional:
        order = compiled.positiontup or []
        rows = list(zip(*(columns[name] for name in order), strict=True))
    else:
        names = list(columns)
        every = zip(*columns.values(), strict=True)
        rows = [dict(zip(names, row, strict=True)) for row in every]
    for start in range(0, len(rows), ROWS_AT_A_TIME):
        chunk = rows[start : start + ROWS_AT_A_TIME]
        connection.exec_driver_sql(str(compiled), chunk)
        if written is not None:
            written(len(chunk))


def update_rows(
    session: Session,
    model: type[Base],
    columns: Mapping[str, Sequence[object]],
    written: Written | None = None,
) -> None:
    """Set columns of many rows; the first of `columns` is the key that finds them."""
    key, *names = columns
    table, connection = _table(model), session.connection()
    if connection.dialect.name != "postgresql":
        changes: dict[str, object] = {name: bindparam(f"to_{name}") for name in names}
        is_row = table.c[key] == bindparam(f"to_{key}")
        named = {f"to_{name}": each for name, each in columns.items()}
        execute_many(
            session, update(table).where(is_row).values(changes), named, written
        )
        return
    statement = update_from_arrays(table, key, tuple(names))
    for start in range(0, len(columns[key]), ROWS_AT_A_TIME):
        end = start + ROWS_AT_A_TIME
        chunk = {f"every_{name}": each[start:end] for name, each in columns.items()}
        connection.execute(statement, chunk)
        if written is not None:
            written(len(columns[key][start:end]))


def chunks(items: Iterable[_Item], most: int = MAX_PARAMETERS) -> Iterator[list[_Item]]:
    """Items in lists of at most `most`: as many as a statement takes as parameters."""
    source = iter(items)
    while chunk := list(islice(source, most)):
        yield chunk


@overload
def run(
    session: Session, statement: TypedReturnsRows[Unpack[_Columns]], **values: object
) -> CursorResult[Unpack[_Columns]]: ...
@overload
def run(
    session: Session, statement: Executable, **values: object
) -> CursorResult[Unpack[tuple[object, ...]]]: ...
def run(
    session: Session, statement: Executable, **values: object
) -> CursorResult[Unpack[tuple[object, ...]]]:
    """Execute a cached statement by the driver, without SQLAlchemy's overhead.

    Result values are not converted, so they should be numbers and text.
    """
    return _run(session.connection(), statement, frozenset(), [values])


def first_row(
    engine: Engine, statement: Executable, **values: object
) -> tuple[object, ...] | None:
    """One row of a statement that needs no transaction; values as in `run`.

    A session and a transaction would cost several times as much as the statement.
    """
    compiled = _compile(statement, frozenset(), engine.dialect)
    with (
        translated(engine.dialect, compiled.text),
        closing(engine.raw_connection()) as connection,
        closing(connection.cursor()) as cursor,
    ):
        cursor.execute(compiled.text, compiled.parameters(values))
        row: tuple[object, ...] | None = cursor.fetchone()
        return row


def run_each(
    session: Session, statement: Executable, rows: Sequence[Mapping[str, object]]
) -> None:
    """Execute a statement once per row, without SQLAlchemy's overhead (`run`).

    All rows have the columns of the first.
    """
    if rows:
        _run(session.connection(), statement, frozenset(rows[0]), rows)


def insert_rows(
    session: Session, model: type[Base], rows: Sequence[Mapping[str, object]]
) -> None:
    """Insert rows without the ORM; no defaults are filled in."""
    dialect = session.connection().dialect.name
    if dialect == "postgresql" and len(rows) >= COPY_FROM_ROWS:
        copy_in(session, model, rows)
    else:
        run_each(session, _insert(model), rows)


def insert_columns(
    session: Session, model: type[Base], columns: Mapping[str, Sequence[object]]
) -> None:
    """Insert rows, given as columns of equal length; no defaults are filled in."""
    connection = session.connection()
    compiled = _compile(_insert(model), frozenset(columns), connection.dialect)
    converted = dict(columns)
    for name, change in compiled.conversions:
        converted[name] = [change(value) for value in converted[name]]
    names = compiled.order or tuple(columns)
    rows = list(zip(*(converted[name] for name in names), strict=True))
    if not rows:
        return
    if compiled.order:
        connection.exec_driver_sql(compiled.text, rows)
    elif len(rows) >= COPY_FROM_ROWS:
        copy_rows(connection, _table(model), names, rows)
    else:
        row = dict(zip(names, rows[0], strict=True))
        connection.exec_driver_sql(compiled.text, row)


def copy_in(
    session: Session, model: type[Base], rows: Sequence[Mapping[str, object]]
) -> None:
    """Insert rows by PostgreSQL's COPY; no defaults are filled in."""
    connection = session.connection()
    compiled = _compile(_insert(model), frozenset(rows[0]), connection.dialect)
    names = list(rows[0])
    converted = (compiled.named(row) for row in rows)
    values = ([row[name] for name in names] for row in converted)
    copy_rows(connection, _table(model), names, values)


@dataclass(frozen=True)
class _Compiled:
    """A statement compiled for the driver, and how to pass its parameters.

    `order` has the names of positional parameters; it is empty if they are passed by
    name. `fixed` are parameters with a value in the statement itself. `conversions` are
    parameters that need converting for the driver (times, JSON), with a function each.
    `in_order` gets the values of `order` from a row, if there are several.
    """

    text: str
    order: tuple[str, ...]
    fixed: Mapping[str, object]
    conversions: tuple[tuple[str, Callable[[object], object]], ...]
    in_order: Callable[[Mapping[str, object]], tuple[object, ...]] | None

    def parameters(
        self, row: Mapping[str, object]
    ) -> tuple[object, ...] | Mapping[str, object]:
        """The parameters of one row in the form that the driver expects."""
        row = self.named(row)
        if self.in_order is not None:
            return self.in_order(row)
        return tuple([row[name] for name in self.order]) if self.order else row

    def named(self, row: Mapping[str, object]) -> Mapping[str, object]:
        """The parameters of one row by name, converted for the driver."""
        if self.fixed or self.conversions:
            row = {**self.fixed, **row}
            row |= {name: change(row[name]) for name, change in self.conversions}
        return row


def _run(
    connection: Connection,
    statement: Executable,
    columns: frozenset[str],
    rows: Sequence[Mapping[str, object]],
) -> CursorResult[Unpack[tuple[object, ...]]]:
    compiled = _compile(statement, columns, connection.dialect)
    values = [compiled.parameters(row) for row in rows]
    return connection.exec_driver_sql(
        compiled.text, values if len(values) > 1 else values[0]
    )


@lru_cache(maxsize=512)
def _compile(
    statement: Executable, columns: frozenset[str], dialect: Dialect
) -> _Compiled:
    keys = sorted(columns) if columns else None
    compiled = cast("ClauseElement", statement).compile(
        dialect=dialect, column_keys=keys
    )
    binds = cast("SQLCompiler", compiled).binds
    changes = {
        name: bind.type.dialect_impl(dialect).bind_processor(dialect)
        for name, bind in binds.items()
        # Both drivers accept True and False, and checking each would take time.
        if not isinstance(bind.type, Boolean)
    }
    order = tuple(cast("SQLCompiler", compiled).positiontup or ())
    return _Compiled(
        text=str(compiled),
        order=order,
        fixed={name: bind.value for name, bind in binds.items() if not bind.required},
        conversions=tuple((name, change) for name, change in changes.items() if change),
        in_order=itemgetter(*order) if len(order) > 1 else None,
    )


def insert_into(session: Session, model: type[Base]) -> DialectInsert:
    """An insert with ``on_conflict_do_...``, for the database of this session."""
    return insert_of_dialect(session.connection().dialect.name, model)


def insert_of_dialect(dialect: str, model: type[Base]) -> DialectInsert:
    """An insert with ``on_conflict_do_...``, for a dialect: for cached statements."""
    if dialect == "postgresql":
        return postgresql.insert(_table(model))
    return sqlite.insert(_table(model))


@lru_cache
def _insert(model: type[Base]) -> Insert:
    return insert(_table(model))


def _table(model: type[Base]) -> Table:
    return cast("Table", model.__table__)


def copy_rows(
    connection: Connection,
    table: Table,
    names: Sequence[str],
    rows: Iterable[Sequence[object]],
) -> None:
    """Insert rows into these columns by COPY, in the connection's transaction.

    Raises the SQLAlchemyError that an insert of the same rows would raise.
    """
    quote = connection.dialect.identifier_preparer.quote
    columns = ", ".join(map(quote, names))
    statement = f"COPY {quote(table.name)} ({columns}) FROM STDIN"
    with (
        translated(connection.dialect, statement),
        closing(connection.connection.cursor()) as cursor,
        cursor.copy(statement) as copy,
    ):
        for row in rows:
            copy.write_row(row)


@lru_cache
def update_from_arrays(table: Table, key: str, names: tuple[str, ...]) -> Update:
    """An update of rows by key, with arrays named ``every_NAME`` as parameters."""
    every = (key, *names)
    sent = func.unnest(
        *(bindparam(f"every_{name}", type_=ARRAY(table.c[name].type)) for name in every)
    ).table_valued(*(column(name, table.c[name].type) for name in every))
    new = sent.render_derived(name="sent")
    return (
        update(table)
        .values({name: new.c[name] for name in names})
        .where(table.c[key] == new.c[key])
    )


@contextmanager
def translated(dialect: Dialect, statement: str) -> Iterator[None]:
    """Raise the driver's errors as the errors of SQLAlchemy that wrap them."""
    failure = dialect.loaded_dbapi.Error
    try:
        yield
    except failure as error:
        raise DBAPIError.instance(
            statement, None, error, failure, hide_parameters=True, dialect=dialect
        ) from error
