"""Fills a database of any revision with rows of that time, without using the models."""

import json
from collections.abc import Mapping
from functools import cache
from typing import Any

from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, inspect, text

from app.package import migrations_dir
from tests.support.sources import CHECKOUT

ROWS = CHECKOUT / "tests" / "migrations" / "rows"
Rows = dict[str, list[dict[str, Any]]]


@cache
def revisions() -> list[str]:
    """The ids of all migrations, the oldest first."""
    config = Config()
    config.set_main_option("script_location", str(migrations_dir()))
    scripts = ScriptDirectory.from_config(config).walk_revisions()
    return [script.revision for script in scripts][::-1]


def fill(engine: Engine, revision: str) -> None:
    """Insert rows into every table that exists at a revision."""
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM id_blocks"))
        for migration in revisions():
            if migration <= revision and (ROWS / f"{migration}.json").exists():
                _insert(connection, _rows_of(migration))


def contents(engine: Engine) -> Rows:
    """All rows of all tables, in a stable order."""
    tables: Rows = {}
    with engine.connect() as connection:
        for table in inspect(connection).get_table_names():
            if table != "alembic_version":
                rows = connection.execute(text(f"SELECT * FROM {table}")).mappings()
                tables[table] = sorted((dict(row) for row in rows), key=repr)
        if engine.dialect.name == "sqlite":
            rows = connection.execute(text("SELECT * FROM sqlite_sequence")).mappings()
            tables["sqlite_sequence"] = sorted((dict(row) for row in rows), key=repr)
    return tables


def restricted(rows: Rows, to: Rows) -> Rows:
    """`rows` without the tables and columns that `to` does not have."""
    tables = {row["name"] for row in to.get("sqlite_sequence", ())}
    rows = dict(rows)
    if tables:
        rows["sqlite_sequence"] = [
            row for row in rows["sqlite_sequence"] if row["name"] in tables
        ]
    return {
        table: sorted(
            ({name: row[name] for name in to[table][0] if name in row} for row in kept),
            key=repr,
        )
        for table, kept in rows.items()
        if to.get(table)
    }


def _rows_of(revision: str) -> Rows:
    rows: Rows = json.loads((ROWS / f"{revision}.json").read_text("utf-8"))
    return rows


def _insert(connection: Connection, rows: Rows) -> None:
    for table, each in rows.items():
        for row in each:
            names = ", ".join(row)
            places = ", ".join(f":{name}" for name in row)
            statement = text(f"INSERT INTO {table} ({names}) VALUES ({places})")
            connection.execute(
                statement, {name: _value(value) for name, value in row.items()}
            )


def _value(value: Any) -> Any:
    return bytes.fromhex(value["hex"]) if isinstance(value, Mapping) else value
