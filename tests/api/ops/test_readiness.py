"""Readiness: each check is made to fail for real, and then to pass again."""

import sqlite3
import time
from contextlib import closing, contextmanager

import pytest
from sqlalchemy.exc import SQLAlchemyError

from app.db.engine import Database
from app.db.transient import takes_writes
from tests.support import plain_http
from tests.support.databases import change, migrated_postgres, rows_of
from tests.support.mounts import read_only, small_disk
from tests.support.servers import running_server
from tests.support.waiting import until

pytestmark = pytest.mark.long

DISK_MIB = 64
MIN_FREE_MIB = 16
MIB = 1024**2
PATIENCE_S = 60


def ask_readyz(url):
    return plain_http.get(f"{url}/readyz", timeout=PATIENCE_S)


def until_not_ready(url):
    """Wait until the server is not ready; return the faults by check."""

    def refusal():
        response = ask_readyz(url)
        return response if response.status_code == 503 else None

    response = until(refusal, "it stays ready")
    assert response.json()["code"] == "not_ready"
    assert int(response.headers["retry-after"]) > 0
    return {fault["code"]: fault["detail"] for fault in response.json()["errors"]}


def until_ready(url):
    """Wait until the server is ready; return what each check found."""

    def consent():
        response = ask_readyz(url)
        return response.json() if response.status_code == 200 else None

    readiness = until(consent, lambda: ask_readyz(url).text)
    assert readiness["ready"] is True
    return readiness["checks"]


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A server whose data folder is a small disk of its own."""
    folder = tmp_path_factory.mktemp("small") / "data"
    settings = {"UNGHOST_MIN_FREE_BYTES": f"{MIN_FREE_MIB}MiB"}
    with small_disk(folder, DISK_MIB), running_server(folder, settings) as server:
        yield server


@contextmanager
def filled_disk(folder, leaving_mib):
    """Fill the disk until only this much space is left, or none."""
    filler = folder / "filler"
    with filler.open("wb", buffering=0) as file:
        try:
            for _ in range(DISK_MIB - leaving_mib):
                file.write(bytes(MIB))
        except OSError:
            pass  # the disk is full, which is wanted
    try:
        yield
    finally:
        filler.unlink()


def test_readyz_of_a_healthy_server_lists_every_check(server):
    checks = until_ready(server.url)

    assert checks.pop("disk").endswith(" bytes free")
    assert checks.pop("migrations").startswith("at 0")
    assert checks.pop("pages") in ("intact", "not checked yet", "checked by PostgreSQL")
    assert checks == {
        "database": "writable",
        "blobs": "writable",
        "background": "working",
        "event_loop": "responsive",
    }


def test_too_little_free_disk_space_is_not_ready(server):
    until_ready(server.url)

    with filled_disk(server.data, leaving_mib=MIN_FREE_MIB // 2):
        faults = until_not_ready(server.url)

    assert list(faults) == ["disk"]
    assert f"{MIN_FREE_MIB * MIB} are needed" in faults["disk"]
    until_ready(server.url)


@pytest.mark.sqlite_files(
    "it shares the small disk of the folder, or its log is looked at"
)
def test_full_disk_fails_the_database_disk_and_blobs_checks(server):
    until_ready(server.url)

    with filled_disk(server.data, leaving_mib=0):

        def three_faults():
            faults = until_not_ready(server.url)
            return faults if len(faults) == 3 else None

        faults = until(three_faults, lambda: until_not_ready(server.url))

    assert set(faults) == {"database", "disk", "blobs"}
    assert "full" in faults["database"]
    assert faults["blobs"] == "No space left on device"
    until_ready(server.url)


def test_read_only_blobs_folder_is_not_ready(server):
    until_ready(server.url)

    with read_only(server.data / "blobs"):
        faults = until_not_ready(server.url)

    assert faults == {"blobs": "Read-only file system"}
    assert "not ready: blobs: Read-only file system" in server.log.read_text("utf-8")
    until_ready(server.url)


@pytest.mark.parametrize(
    ("revision", "advice"),
    [
        ("0001", "restart to migrate it"),
        ("9999", "a newer version of Unghost has migrated it"),
    ],
)
def test_a_schema_of_another_version_is_not_ready(server, revision, advice):
    ((head,),) = rows_of(server.data, "SELECT version_num FROM alembic_version")

    change(server.data, f"UPDATE alembic_version SET version_num = '{revision}'")
    faults = until_not_ready(server.url)
    change(server.data, f"UPDATE alembic_version SET version_num = '{head}'")

    assert list(faults) == ["migrations"]
    assert f"at {revision}, this version needs {head}" in faults["migrations"]
    assert advice in faults["migrations"]
    until_ready(server.url)


@pytest.mark.sqlite_files("its only place for writers; PostgreSQL has many")
def test_database_locked_by_another_writer_is_ready(server):
    def is_noticed():
        checks = ask_readyz(server.url).json().get("checks", {})
        return checks.get("database") == "locked by another writer"

    with closing(sqlite3.connect(server.data / "unghost.db")) as database:
        database.execute("BEGIN IMMEDIATE")
        until(is_noticed)
        database.rollback()


@pytest.mark.sqlite_files(
    "it shares the small disk of the folder, or its log is looked at"
)
def test_frequent_readyz_requests_do_not_write_each_time(server):
    until_ready(server.url)
    with closing(sqlite3.connect(server.data / "unghost.db")) as database:
        emptied = database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    begun = time.monotonic()

    with plain_http.Client(base_url=server.url) as client:
        statuses = [client.get("/readyz").status_code for _ in range(50)]

    wal = server.data / "unghost.db-wal"
    # The server writes once a second, one page each time.
    assert wal.stat().st_size // 4096 <= time.monotonic() - begun + 2
    assert set(statuses) == {200}
    assert emptied[0] == 0

    def is_written():
        ask_readyz(server.url)
        return wal.stat().st_size > 0

    until(is_written)


def test_takes_writes_is_false_during_another_write_and_raises_if_read_only():
    with migrated_postgres() as url:
        with closing(Database(url)) as database:
            with database.engine.connect() as other:
                other.exec_driver_sql("UPDATE alembic_version SET version_num = '2'")
                beside = takes_writes(database)
            alone = takes_writes(database)
            name = url.rpartition("/")[2]
            with database.engine.begin() as connection:
                connection.exec_driver_sql(
                    f"ALTER DATABASE {name} SET default_transaction_read_only = on"
                )
        with closing(Database(url)) as database, pytest.raises(SQLAlchemyError):
            takes_writes(database)

    assert (beside, alone) == (False, True)
