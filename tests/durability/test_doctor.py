"""`unghost doctor` finds faults of a data folder, says what to do, changes nothing."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import pytest

from app.maintenance.doctor import Severity
from tests.support import frames as scene
from tests.support.data_folders import blobs, doctor_findings, served


def rows(data, statement):
    with closing(sqlite3.connect(data / "unghost.db")) as database, database:
        database.execute("PRAGMA foreign_keys=OFF")
        return database.execute(statement).fetchall()


def state_of(data):
    return {
        path: (path.stat().st_mtime_ns, path.stat().st_size)
        for path in data.rglob("*")
        if path.is_file() and not path.name.endswith(("-shm", "-wal"))
    }


@pytest.mark.sqlite_files("its file is damaged, missing or compared")
def test_a_folder_in_order_is_left_as_it_is(filled, unghost):
    before = state_of(filled)

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
    assert state_of(filled) == before


def flipped(data):
    content = bytearray(blobs(data)[0].read_bytes())
    content[len(content) // 2] ^= 4
    blobs(data)[0].write_bytes(content)


def cut(data):
    blobs(data)[0].write_bytes(blobs(data)[0].read_bytes()[:-1])


def gone(data):
    blobs(data)[0].unlink()


@pytest.mark.parametrize("spoil", [flipped, cut, gone])
def test_a_damaged_file_is_found_and_named(filled, spoil):
    name = blobs(filled)[0].name
    spoil(filled)

    found = doctor_findings(filled)

    assert found["files"].severity is Severity.ERROR
    assert (found["files"].count, found["files"].examples) == (1, (name,))
    assert "backup" in found["files"].todo


def test_faults_are_told_by_the_exit_code_and_in_words(filled, unghost):
    (filled / "token").chmod(0o644)
    warned = unghost("doctor")
    cut(filled)
    failed = unghost("doctor")

    assert (warned.code, failed.code) == (3, 1)
    assert "others can read the token file (mode 644)" in warned.out
    assert "0 are missing and 1 damaged" in failed.out
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
def test_a_database_that_does_not_fit_is_found(filled, statement, check):
    rows(filled, statement)

    assert doctor_findings(filled)[check].todo


@pytest.mark.sqlite_files("its file is damaged, missing or compared")
def test_a_damaged_database_is_found(filled):
    with (filled / "unghost.db").open("r+b") as file:
        file.seek(4096 * 3)
        file.write(b"\xff" * 4096)

    found = doctor_findings(filled)["database"]

    assert found.severity is Severity.ERROR
    assert "restore the last backup" in found.todo


@pytest.mark.sqlite_files("its file is damaged, missing or compared")
def test_a_database_that_is_missing_is_not_made(filled):
    (filled / "unghost.db").unlink()

    found = doctor_findings(filled)["database"]

    assert (found.severity, found.found) == (Severity.ERROR, "the database is missing")
    assert not (filled / "unghost.db").exists()


def test_little_room_is_said(filled):
    assert (
        doctor_findings(filled, min_free_bytes=2**60)["disk"].severity
        is Severity.WARNING
    )


def test_the_doctor_examines_a_folder_that_is_served(tmp_path):
    with served(tmp_path / "data") as (_, api):
        dataset = api.dataset()
        api.upload_frame(
            dataset, "f/0", image=scene.image(), segmentation=scene.segmentation()
        )

        assert doctor_findings(tmp_path / "data") == {}
