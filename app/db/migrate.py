"""Migrates a database to the schema that this version needs.

A migration is a file in ``versions``, named by its revision: ``0002_name.py`` follows
``0001_name.py``. Alembic runs them. It is imported only if there are migrations to run,
since it takes eight megabytes of memory.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from sqlalchemy import Connection, Engine, func, inspect, select, text

_MAY_LOSE: Final = "may_lose"


class WouldLose(Exception):
    """A downgrade would delete rows that people made; the text says how many."""


def migrate(
    engine: Engine, scripts: Path, revision: str = "head", *, may_lose: bool = False
) -> None:
    """Upgrade or downgrade to a revision, in one transaction.

    Raises `WouldLose` if a downgrade would drop a table with rows that people made,
    such as the audit log, unless `may_lose` is true.

    SQLite rebuilds a table to change it, which with foreign keys on would silently
    delete the rows of its children: foreign keys are off meanwhile, and checked
    afterwards. The check takes seconds for millions of rows, so a database that is at
    the revision already is left alone.
    """
    target = {"head": head_revision(scripts), "base": None}.get(revision, revision)
    if target is not None and target == current_revision(engine):
        return
    with engine.connect() as connection:
        if connection.dialect.name != "sqlite":
            with connection.begin():
                _run(connection, scripts, revision, may_lose=may_lose)
            return
        _sqlite_foreign_keys(connection, on=False)
        try:
            with connection.execution_options(writes=True).begin():
                _run(connection, scripts, revision, may_lose=may_lose)
                broken = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
                if broken:
                    raise RuntimeError(
                        f"the migration left {len(broken)} rows without a parent"
                    )
        finally:
            _sqlite_foreign_keys(connection, on=True)


def current_revision(engine: Engine) -> str | None:
    """The revision of a database; None for an empty one."""
    with engine.connect() as connection:
        return _revision_of(connection)


def head_revision(scripts: Path) -> str | None:
    """The revision that this version needs; None if there are no migrations."""
    return max(_revisions(scripts), default=None)


def is_known(scripts: Path, revision: str) -> bool:
    """Whether this version has a migration of this name."""
    return revision in _revisions(scripts)


def refuse_to_lose(table: str, where: str = "1 = 1", what: str = "") -> None:
    """For downgrades: raises WouldLose if a table has rows that fulfil a condition.

    `what` says what would be lost, if that is not the rows themselves.
    """
    from alembic import context, op

    connection, config = op.get_bind(), context.config
    counted = select(func.count()).select_from(text(table)).where(text(where))
    rows = connection.execute(counted)
    if (count := rows.scalar_one()) and not config.attributes.get(_MAY_LOSE, False):
        raise WouldLose(
            f"this downgrade would lose {what or f'the {count} rows of {table}'}, and "
            "nothing was changed; make a backup, and pass may_lose=True to lose them"
        )


def _run(
    connection: Connection, scripts: Path, revision: str, *, may_lose: bool
) -> None:
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(scripts).replace("%", "%%"))
    config.attributes["connection"] = connection
    config.attributes[_MAY_LOSE] = may_lose
    current = _revision_of(connection) or ""
    if revision == "head" or (revision != "base" and revision > current):
        command.upgrade(config, revision)
    else:
        command.downgrade(config, revision)


def _revision_of(connection: Connection) -> str | None:
    if not inspect(connection).has_table("alembic_version"):
        return None
    rows = connection.execute(text("SELECT version_num FROM alembic_version"))
    revision: str | None = rows.scalar_one_or_none()
    return revision


def _revisions(scripts: Path) -> set[str]:
    files = (scripts / "versions").glob("[0-9]*_*.py")
    return {file.name.partition("_")[0] for file in files}


def _sqlite_foreign_keys(connection: Connection, *, on: bool) -> None:
    # The pragma has no effect inside a transaction, so the driver executes it.
    driver = connection.connection.dbapi_connection
    if driver is not None:
        driver.cursor().execute(f"PRAGMA foreign_keys={'ON' if on else 'OFF'}")
