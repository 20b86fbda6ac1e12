"""Which database errors are transient, tested with errors of SQLite and PostgreSQL."""

import sqlite3
from contextlib import closing

import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.exc import SQLAlchemyError

from app.db.engine import make_engine
from app.db.transient import in_a_line, is_transient
from tests.support.databases import empty_postgres


def error_of_last_statement(url, *before, last):
    """The error that the last statement raises."""
    engine = create_engine(url, connect_args={"timeout": 0})
    with engine.connect() as connection:
        for statement in before:
            connection.exec_driver_sql(statement)
        with pytest.raises(SQLAlchemyError) as raised:
            connection.exec_driver_sql(last)
    engine.dispose()
    return raised.value


def test_a_locked_database_is_transient_and_a_full_disk_is_not(tmp_path):
    file = tmp_path / "some.db"
    make = "CREATE TABLE some (one TEXT)"
    full = error_of_last_statement(
        f"sqlite:///{file}",
        "PRAGMA max_page_count = 2",
        make,
        last="INSERT INTO some VALUES (hex(randomblob(20000)))",
    )
    with closing(sqlite3.connect(file)) as other:
        other.execute("BEGIN EXCLUSIVE")
        locked = error_of_last_statement(f"sqlite:///{file}", last=make)

    assert (is_transient(full), is_transient(locked)) == (False, True), (full, locked)
    assert in_a_line(locked) == "(sqlite3.OperationalError) database is locked"


TERMINATE_CONNECTION = "SELECT pg_terminate_backend(pg_backend_pid())"
TIME_OUT = "SET statement_timeout = 1; SELECT pg_sleep(1)"
UNKNOWN_TABLE = "SELECT * FROM nothing"


@pytest.mark.parametrize(
    ("statement", "passes"),
    [(TERMINATE_CONNECTION, True), (TIME_OUT, False), (UNKNOWN_TABLE, False)],
)
def test_terminated_connection_is_transient_and_statement_error_is_not(
    statement, passes
):
    with empty_postgres() as url:
        engine = make_engine(url)
        with engine.connect() as connection, pytest.raises(SQLAlchemyError) as raised:
            connection.execute(text(statement))
        engine.dispose()
    nowhere = make_engine("postgresql+psycopg://postgres@127.0.0.1:1/nothing")
    with pytest.raises(SQLAlchemyError) as unreachable:
        nowhere.connect()

    assert is_transient(raised.value) is passes
    assert is_transient(unreachable.value)
