"""`unghost doctor` finds faults of a data folder, says what to do, changes nothing."""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing

import pytest

from app.maintenance.doctor import Severity
from tests.support import frames as scene
from tests.support.data_folders import blobs, doctor_findings, served


def execute_sql(data, statement):
    with closing(sqlite3.connect(data / "unghost.db")) as database, database:
        database.execute("PRAGMA foreign_keys=OFF")
        return database.execute(statement).fetchall()


def file_times_and_sizes(data):
    return {
        path: (path.stat().st_mtime_ns, path.stat().st_size)
        for path in data.rglob("*")
        if path.is_file() and not path.name.endswith(("-shm", "-wal"))
    }


@pytest.mark.sqlite_files("its file is damaged, missing or compared")
def test_doctor_reports_ok_and_changes_nothing_in_an_intact_folder(filled, unghost):
    before = file_times_and_sizes(filled)

    healthy = unghost("doctor", "--verify", "--json")

    assert healthy.code == 0, healthy.out
    assert {found["severity"] for found in healthy.records} == {"ok"}
    assert [found["check"] for found in healthy.records] == [
        "token",
        "disk",
        "database",
        "schema",
        "files",
        "exports",
        "unused",
        "leftovers",
    ]
    assert file_times_and_sizes(filled) == before


def flip_a_bit(data):
    content = bytearray(blobs(data)[0].read_bytes())
    content[len(content) // 2] ^= 4
    blobs(data)[0].write_bytes(content)


def truncate_a_blob(data):
    blobs(data)[0].write_bytes(blobs(data)[0].read_bytes()[:-1])


def delete_a_blob(data):
    blobs(data)[0].unlink()


@pytest.mark.parametrize("spoil", [flip_a_bit, truncate_a_blob, delete_a_blob])
def test_damaged_or_missing_file_is_reported_by_name(filled, spoil):
    name = blobs(filled)[0].name
    spoil(filled)

    found = doctor_findings(filled)

    assert found["files"].severity is Severity.ERROR
    assert (found["files"].count, found["files"].examples) == (1, (name,))
    assert "backup" in found["files"].todo


def test_doctor_reports_faults_with_exit_code_and_messages(filled, unghost):
    (filled / "token").chmod(0o644)
    warned = unghost("doctor")
    truncate_a_blob(filled)
    failed = unghost("doctor")

    assert (warned.code, failed.code) == (3, 1)
    assert "others can read the token file (mode 644)" in warned.out
    assert re.search(r"\b0 of \d+ are missing, 1 are damaged", failed.out)
    assert "-> copy them from the folder blobs of a backup" in failed.out


@pytest.mark.sqlite_files("its file is damaged, missing or compared")
@pytest.mark.parametrize(
    ("statement", "check"),
    [
        ("DELETE FROM frames WHERE id = 1", "database"),
        ("UPDATE alembic_version SET version_num = '9999'", "schema"),
        ("UPDATE alembic_version SET version_num = '0001'", "schema"),
    ],
)
def test_inconsistent_rows_or_wrong_schema_version_are_reported(
    filled, statement, check
):
    execute_sql(filled, statement)

    assert doctor_findings(filled)[check].todo


@pytest.mark.sqlite_files("its file is damaged, missing or compared")
def test_damaged_database_is_reported(filled):
    with (filled / "unghost.db").open("r+b") as file:
        file.seek(4096 * 3)
        file.write(b"\xff" * 4096)

    found = doctor_findings(filled)["database"]

    assert found.severity is Severity.ERROR
    assert "restore the last backup" in found.todo


@pytest.mark.sqlite_files("its file is damaged, missing or compared")
def test_missing_database_is_reported_and_not_created(filled):
    (filled / "unghost.db").unlink()

    found = doctor_findings(filled)["database"]

    assert (found.severity, found.found) == (Severity.ERROR, "the database is missing")
    assert not (filled / "unghost.db").exists()


def test_low_free_disk_space_gives_a_warning(filled):
    assert (
        doctor_findings(filled, min_free_bytes=2**60)["disk"].severity
        is Severity.WARNING
    )


def test_doctor_examines_a_folder_while_a_server_uses_it(tmp_path):
    with served(tmp_path / "data") as (_, api):
        dataset = api.dataset()
        api.upload_frame(
            dataset, "f/0", image=scene.image(), segmentation=scene.segmentation()
        )

        assert doctor_findings(tmp_path / "data") == {}
