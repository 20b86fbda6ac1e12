"""Makes databases for tests: SQLite files, or databases of a PostgreSQL server.

UNGHOST_TEST_DATABASE may name a database of a server, such as
``postgresql+psycopg://postgres@127.0.0.1:5432/postgres``. Then each data folder of the
tests gets a new database on that server in place of its SQLite file, and all of them
are dropped again.

UNGHOST_TEST_SERVER names a database of the server that single tests of PostgreSQL use.
"""

import os
import sys
import uuid
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from sqlalchemy import (
    URL,
    Connection,
    Engine,
    create_engine,
    inspect,
    make_url,
    text,
    update,
)
from sqlalchemy.exc import OperationalError

from app.db import inspection
from app.db.engine import Database, make_engine
from app.db.inspection import broken_keys
from app.db.migrate import migrate
from app.db.tables import Installation
from app.package import migrations_dir
from app.storage.durable import make_folder

# Read at import: the tests later run without any UNGHOST_* variables.
CHOSEN = os.environ.get("UNGHOST_TEST_DATABASE", "")
SERVER_VARIABLE = "UNGHOST_TEST_SERVER"
_DEFAULT = "postgresql+psycopg://postgres@127.0.0.1:5432/postgres"
SERVER = make_url(CHOSEN or os.environ.get(SERVER_VARIABLE) or _DEFAULT)
DATABASE_URL = "UNGHOST_DATABASE_URL"
FILE = "unghost.db"
_PREFIX = "unghost_test_"
_of_folders: dict[Path, URL] = {}
_template: list[URL] = []


@contextmanager
def empty_postgres(language: str = "") -> Iterator[str]:
    """Yield the URL of a new, empty database, and drop it at the end.

    Skips the test if no server answers. The database sorts text as the server does, or
    by the rules of `language`, such as ``en-US``.
    """
    own = f" TEMPLATE template0 LOCALE_PROVIDER icu ICU_LOCALE '{language}'"
    yield from _temporary(own if language else "")


@contextmanager
def migrated_postgres() -> Iterator[str]:
    """Yield the URL of a new database like `empty_postgres`, but with all tables."""
    _require_postgres()
    yield from _temporary(f" TEMPLATE {_migrated().database}")


def settings_of(data: Path) -> dict[str, str]:
    """The keys of `Settings` that name the database of a data folder."""
    return {"database_url": _text(_database_of(data))} if CHOSEN else {}


def environment_of(data: Path) -> dict[str, str]:
    """The same as `settings_of`, as variables of a process's environment."""
    return {DATABASE_URL: _text(_database_of(data))} if CHOSEN else {}


def give_tables(data: Path, settings: Mapping[str, object]) -> None:
    """Put a database with all tables, but no rows, into a new data folder.

    A service makes missing tables itself, but that takes longer than the rest of its
    start. `settings` are those of the service: nothing is done if they name another
    place for the database or the files.
    """
    named = {name.removeprefix("UNGHOST_").lower() for name in settings}
    is_new = not data.exists() or not any(data.iterdir())
    if CHOSEN or named & {"database_url", "storage"} or not is_new:
        return
    make_folder(data)
    (data / FILE).write_bytes(migrated_file())
    _give_own_id(url_of(data))


def url_of(data: Path) -> str:
    """The URL of the database of a data folder."""
    return _text(_database_of(data)) if CHOSEN else f"sqlite:///{data / FILE}"


@contextmanager
def database_of(data: Path) -> Iterator[Connection]:
    """Connect to the database of a data folder past the service; commits at the end."""
    with (
        closing(Database(url_of(data))) as database,
        database.engine.begin() as connection,
    ):
        yield connection


def rows_of(data: Path, statement: str, **values: object) -> list[tuple]:
    """Run a statement on the database of a data folder, and return the rows."""
    with database_of(data) as connection:
        return [tuple(row) for row in connection.execute(text(statement), values)]


def change(data: Path, *statements: str, **values: object) -> None:
    """Run statements that change the database of a data folder, past the service."""
    with database_of(data) as connection:
        for statement in statements:
            connection.execute(text(statement), values)


def everything_in(data: Path) -> str:
    """All rows of all tables as one text, to compare two states of a database."""
    with database_of(data) as connection:
        tables = sorted(inspect(connection).get_table_names())
        return "\n".join(
            repr(row)
            for table in tables
            for row in sorted(
                connection.execute(text(f"SELECT * FROM {table}")), key=repr
            )
        )


def problems_of(data: Path) -> list[str]:
    """The problems that `unghost doctor` finds in a database that is not served."""
    if not CHOSEN:
        return inspection.problems_of(data / FILE)
    with closing(Database(_text(_database_of(data)))) as database:
        return broken_keys(database.engine)


@contextmanager
def hold_write_lock(data: Path) -> Iterator[None]:
    """Hold the database's write lock during the block, as a long transaction does."""
    with closing(Database(url_of(data))) as database, database.write() as session:
        session.connection()
        yield


def drop_unused() -> None:
    """Drop the databases of data folders to which no connection is open any more."""
    with _server() as server:
        rows = server.execute(text("SELECT DISTINCT datname FROM pg_stat_activity"))
        open_now = set(rows.scalars())
        for data, url in list(_of_folders.items()):
            if url.database not in open_now:
                _drop(server, _of_folders.pop(data))


def drop_all() -> None:
    """Drop all databases of data folders, and the one that they were copied from."""
    if not _of_folders and not _template:
        return
    with _server() as server:
        for url in (*_of_folders.values(), *_template):
            _drop(server, url)
    _of_folders.clear()
    _template.clear()


def is_reachable(server: URL | str = SERVER) -> bool:
    """Whether a PostgreSQL server answers at this URL."""
    try:
        with _server(server):
            return True
    except OperationalError:
        return False


def _temporary(options: str) -> Iterator[str]:
    _require_postgres()
    url = _created(options)
    try:
        yield _text(url)
    finally:
        with _server() as server:
            _drop(server, url)


def _require_postgres() -> None:
    # In continuous integration, or if one is named, a missing server is a failure.
    if not (is_reachable() or CHOSEN or os.environ.get("CI")):
        pytest.skip(f"no PostgreSQL answers at {SERVER.host}:{SERVER.port}")


def _database_of(data: Path) -> URL:
    folder = data.resolve()
    if folder not in _of_folders:
        _of_folders[folder] = _created(f" TEMPLATE {_migrated().database}")
        _give_own_id(_text(_of_folders[folder]))
    return _of_folders[folder]


def _give_own_id(url: str) -> None:
    """Give a copied database an installation id of its own.

    Workers recognise the database of their server by this id.
    """
    with closing(Database(url)) as database, database.engine.begin() as connection:
        connection.execute(update(Installation).values(id=str(uuid.uuid4())))


def _migrated() -> URL:
    """The database that others are copied from: copying is faster than migrating."""
    if not _template:
        url = _created("")
        engine = make_engine(_text(url))
        migrate(engine, migrations_dir())
        engine.dispose()
        _template.append(url)
    return _template[0]


@lru_cache(maxsize=1)
def migrated_file() -> bytes:
    """An SQLite file with all tables, but no rows: copying is faster than migrating."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / FILE
        with closing(Database(f"sqlite:///{file}")) as database:
            migrate(database.engine, migrations_dir())
        return file.read_bytes()


def _created(options: str) -> URL:
    url = SERVER.set(database=f"{_PREFIX}{uuid.uuid4().hex}")
    with _server() as server:
        server.execute(text(f"CREATE DATABASE {url.database}{options}"))
    return url


def _drop(server: Connection, url: URL) -> None:
    server.execute(text(f"DROP DATABASE IF EXISTS {url.database} WITH (FORCE)"))


def _text(url: URL) -> str:
    return url.render_as_string(hide_password=False)


@contextmanager
def _server(server: URL | str = SERVER) -> Iterator[Connection]:
    engine: Engine = create_engine(server, isolation_level="AUTOCOMMIT")
    try:
        with engine.connect() as connection:
            yield connection
    finally:
        engine.dispose()


if __name__ == "__main__":
    if not is_reachable():
        sys.exit(f"no PostgreSQL answers at {SERVER.render_as_string()}")
    print(_text(SERVER))
