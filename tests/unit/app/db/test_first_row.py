"""`first_row` reads a row without a session: the same values, and the same errors."""

import sqlite3
from contextlib import closing

import pytest
from sqlalchemy import Integer, Select, bindparam, column, literal, select, table
from sqlalchemy.exc import OperationalError

from app.db.bulk import first_row
from app.db.engine import make_engine

DOUBLED = select(bindparam("number", type_=Integer) * 2, literal("two").label("word"))


@pytest.fixture
def engine(tmp_path):
    engine = make_engine(f"sqlite:///{tmp_path}/some.db")
    yield engine
    engine.dispose()


def test_first_row_returns_the_values_of_the_driver_or_none(engine):
    assert first_row(engine, DOUBLED, number=21) == (42, "two")
    assert first_row(engine, DOUBLED.where(literal(1) == 0), number=1) is None


def test_first_row_leaves_no_open_reader(engine, tmp_path):
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE numbers (number INTEGER)")
        connection.exec_driver_sql("INSERT INTO numbers VALUES (1), (2), (3)")

    first_row(engine, select(column("number")).select_from(table("numbers")))

    with closing(sqlite3.connect(tmp_path / "some.db")) as other:
        # A reader that was still open would block this checkpoint.
        is_held_up, *_ = other.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    assert not is_held_up


def test_first_row_raises_operational_error_and_returns_its_connection(engine):
    missing: Select = select(column("some")).select_from(table("nowhere"))

    with pytest.raises(OperationalError, match="no such table: nowhere"):
        first_row(engine, missing)
    assert engine.pool.checkedout() == 0
