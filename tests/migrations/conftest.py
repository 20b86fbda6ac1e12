"""An empty database of each kind, and one with all tables: SQLite and PostgreSQL."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import Engine

from app.db.engine import make_engine
from tests.support.databases import empty_postgres, migrated_file, migrated_postgres


@pytest.fixture(params=["sqlite", "postgresql"])
def engine(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Engine]:
    """An engine for an empty database; each test runs once for each kind."""
    if request.param == "sqlite":
        yield from _engine(f"sqlite:///{tmp_path}/empty.sqlite3")
        return
    with empty_postgres() as url:
        yield from _engine(url)


@pytest.fixture(params=["sqlite", "postgresql"])
def migrated(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Engine]:
    """The same for a database of the newest schema, in which nothing is stored."""
    if request.param == "sqlite":
        (tmp_path / "new.sqlite3").write_bytes(migrated_file())
        yield from _engine(f"sqlite:///{tmp_path}/new.sqlite3")
        return
    with migrated_postgres() as url:
        yield from _engine(url)


def _engine(url: str) -> Iterator[Engine]:
    engine = make_engine(url)
    yield engine
    engine.dispose()
