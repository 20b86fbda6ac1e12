"""PostgreSQL's own ways for many rows: COPY, and one update of rows that are sent."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any

from sqlalchemy import (
    ARRAY,
    Connection,
    Dialect,
    Table,
    Update,
    bindparam,
    column,
    func,
    update,
)
from sqlalchemy.exc import DBAPIError


def copy_rows(
    connection: Connection,
    table: Table,
    names: Sequence[str],
    rows: Iterable[Sequence[Any]],
) -> None:
    """Insert rows into these columns by COPY, in the connection's transaction.

    Raises
    ------
    SQLAlchemyError
        What an insert of the same rows would raise.
    """
    quote = connection.dialect.identifier_preparer.quote
    columns = ", ".join(map(quote, names))
    statement = f"COPY {quote(table.name)} ({columns}) FROM STDIN"
    driver: Any = connection.connection.dbapi_connection
    with (
        translated(connection.dialect, statement),
        closing(driver.cursor()) as cursor,
        cursor.copy(statement) as copy,
    ):
        for row in rows:
            copy.write_row(row)


def update_from_arrays(table: Table, key: str, names: Sequence[str]) -> Update:
    """Set columns of rows by their keys; its parameters are arrays, ``every_NAME``."""
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
    """What the driver raises, in SQLAlchemy's words as if it had run the statement."""
    failure = dialect.loaded_dbapi.Error
    try:
        yield
    except failure as error:
        raise DBAPIError.instance(
            statement, None, error, failure, hide_parameters=True, dialect=dialect
        ) from error
