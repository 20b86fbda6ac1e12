"""`unghost doctor` finds faults of a data folder, says what to do, changes nothing."""

import re
import sqlite3
from contextlib import closing

import pytest

from app.maintenance.doctor import Severity
from tests.support.data_folders import blobs, doctor_findings, served
from tests.support.databases import change, database_of, rows_of
from tests.support.services import ServiceDataset, running_services


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
    assert {finding["severity"] for finding in healthy.records} == {"ok"}
    assert [finding["check"] for finding in healthy.records] == [
        *("token", "disk", "database", "schema", "audit", "answers", "counts"),
        *("files", "exports", "unused", "leftovers"),
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

    findings = doctor_findings(filled)

    assert findings["files"].severity is Severity.ERROR
    assert (findings["files"].count, findings["files"].examples) == (1, (name,))
    assert "backup" in findings["files"].todo


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
def test_damaged_or_missing_database_and_low_disk_space_are_reported(filled):
    little = doctor_findings(filled, min_free_bytes=2**60)["disk"]
    with (filled / "unghost.db").open("r+b") as file:
        file.seek(4096 * 3)
        file.write(b"\xff" * 4096)
    damaged = doctor_findings(filled)["database"]
    (filled / "unghost.db").unlink()
    missing = doctor_findings(filled)["database"]

    assert little.severity is Severity.WARNING
    assert damaged.severity is missing.severity is Severity.ERROR
    assert "restore the last backup" in damaged.todo
    assert missing.found == "the database is missing"
    assert not (filled / "unghost.db").exists()


def test_run_that_activates_counts_altered_tallies_again(tmp_path):
    """The folder is examined while its server uses it."""
    data = tmp_path / "data"
    with served(data) as (_, api):
        name = api.dataset_of_one_frame()
        assert doctor_findings(data) == {}
        change(data, "UPDATE tallies SET boxes = boxes + 1")
        fault = doctor_findings(data)["counts"]
        api.run(name, {})

        assert fault.severity is Severity.WARNING
        assert name in fault.examples[0]
        assert "--activate" in fault.todo
        assert doctor_findings(data) == {}


@pytest.fixture
def answered(filled):
    """A data folder with three answers on one box, a bulk answer, and audit entries."""
    with running_services(filled) as services:
        ((name, id_),) = rows_of(filled, "SELECT name, id FROM datasets")
        street = ServiceDataset(services, name, id_)
        box, *others = street.box_ids()
        for verdict in ("keep", "reject", "unsure"):
            street.review(box, verdict)
        street.bulk(others, "keep")
    assert doctor_findings(filled).keys() <= {"token"}
    return filled


@pytest.mark.parametrize(
    ("statement", "check"),
    [
        ("DELETE FROM reviews WHERE revision = 2", "answers"),
        ("DELETE FROM reviews WHERE revision = 3", "answers"),
        ("DELETE FROM reviews WHERE batch_id = 1", "answers"),
        ("UPDATE reviews SET verdict = 'keep' WHERE revision = 3", "answers"),
        ("UPDATE tallies SET boxes = boxes + 1 WHERE review = 'keep'", "counts"),
        ("DELETE FROM tallies WHERE review = 'unsure'", "counts"),
    ],
)
def test_removed_answers_and_altered_counts_are_reported(answered, statement, check):
    change(answered, statement)

    findings = doctor_findings(answered)

    assert {name for name in findings if name != "token"} == {check}
    assert findings[check].count > 0
    assert findings[check].examples
    assert findings[check].todo


def drop_audit_triggers(data):
    with database_of(data) as connection:
        is_sqlite = connection.dialect.name == "sqlite"
    names = ["no_update", "no_delete"] if is_sqlite else ["no_change"]
    on = "" if is_sqlite else " ON audit_log"
    change(data, *(f"DROP TRIGGER audit_log_{name}{on}" for name in names))
    return len(names)


def test_dropped_audit_triggers_are_reported_with_statements_that_restore_them(
    answered,
):
    dropped = drop_audit_triggers(answered)

    fault = doctor_findings(answered)["audit"]

    assert (fault.severity, fault.count) == (Severity.ERROR, dropped)
    for statements in fault.examples:
        change(answered, *statements.split("; ", 1))
    assert "audit" not in doctor_findings(answered)
    with pytest.raises(Exception, match="the audit log is only added to"):
        change(answered, "DELETE FROM audit_log")


@pytest.mark.sqlite_files("a backup of it is made")
def test_audit_log_is_compared_with_what_a_backup_has_printed(answered, unghost):
    made = unghost("backup", "copy", "--json").records[0]
    printed = unghost("backup", "copy.tar")
    mark = made["audit"]
    with served(answered) as (_, api):
        api.dataset()
    longer = unghost("doctor", "--audit", mark, "--json")
    drop_audit_triggers(answered)
    triggers = doctor_findings(answered)["audit"].examples
    change(answered, "DELETE FROM audit_log WHERE id = 1")
    for statements in triggers:
        change(answered, *statements.split("; ", 1))
    unseen = unghost("doctor", "--json")
    compared = unghost("doctor", "--audit", mark, "--json")
    shorter = unghost("doctor", "--audit", "999:" + "0" * 64)
    wrong = unghost("doctor", "--audit", "17")

    assert re.fullmatch(r"[1-9]\d*:[0-9a-f]{64}", mark)
    assert f"doctor --audit {mark}" in printed.out
    assert longer.code == 0, longer.out
    assert unseen.code == 0, unseen.out
    assert (compared.code, shorter.code, wrong.code) == (1, 1, 2)
    (audit,) = (finding for finding in compared.records if finding["check"] == "audit")
    assert (audit["severity"], audit["count"]) == ("error", 1)
    assert "are not those" in audit["found"]
    assert "of 999" in shorter.out
    assert "expected COUNT:SHA256" in wrong.err
