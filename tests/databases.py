"""Databases of a test's own on PostgreSQL, where one answers."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.exc import OperationalError

POSTGRES = "postgresql+psycopg://postgres@127.0.0.1:5432"


@contextmanager
def empty_postgres() -> Iterator[str]:
    """The URL of a new database, dropped at the end; a skip if no server answers.

    Only continuous testing must have one: there it is an error.
    """
    server = create_engine(f"{POSTGRES}/postgres", isolation_level="AUTOCOMMIT")
    name = f"unghost_test_{uuid.uuid4().hex}"
    try:
        with server.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
    except OperationalError:
        if os.environ.get("CI") == "true":
            raise
        pytest.skip("no PostgreSQL answers at 127.0.0.1:5432 as user postgres")
    try:
        yield f"{POSTGRES}/{name}"
    finally:
        with server.connect() as connection:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
        server.dispose()
