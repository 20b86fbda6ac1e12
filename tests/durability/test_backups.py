"""Tests `unghost backup` and `unghost restore`: complete, refused and interrupted."""

import errno
import json
import os
import shutil
import sqlite3
import tarfile
import threading
from contextlib import closing
from pathlib import Path

import pytest

from app.maintenance.backup import MAX_LABEL_BYTES, make_backup
from app.maintenance.datafolder import CannotMaintain
from app.maintenance.restore import restore
from app.serve import check_free
from app.settings import Settings
from app.storage.base import digest_of
from app.storage.durable import MAINTENANCE_LOCK, locked
from tests.support import frames as scene
from tests.support import without_locks
from tests.support.data_folders import (
    backed_up,
    blobs,
    doctor_findings,
    restored,
    served,
    silently,
)
from tests.support.processes import start_anew
from tests.support.waiting import until

pytestmark = [pytest.mark.long, pytest.mark.sqlite_files("a backup copies its file")]

TARGETS = ["kept", "kept.tar"]


def keys(data):
    with closing(sqlite3.connect(data / "unghost.db")) as database:
        return {row[0] for row in database.execute("SELECT key FROM frames")}


def test_backup_of_busy_server_has_every_frame_acknowledged_before_it(
    tmp_path, unghost
):
    stop = threading.Event()
    answered: list[str] = []

    def upload_until_stopped(api, dataset):
        while not stop.is_set():
            number = len(answered)
            files = {"image": scene.image(number), "segmentation": scene.segmentation()}
            api.upload_frame(dataset, f"f/{number}", **files)
            answered.append(f"f/{number}")

    with served(tmp_path / "data") as (_, api):
        sending = threading.Thread(
            target=upload_until_stopped, args=(api, api.dataset())
        )
        sending.start()
        try:
            until(lambda: len(answered) >= 10 or not sending.is_alive())
            assert sending.is_alive()
            before = {*answered}
            made = unghost("backup", "kept.tar", "--json")
        finally:
            stop.set()
            sending.join()

    assert made.code == 0, made.err
    restored(tmp_path / "kept.tar", tmp_path / "again")
    assert before <= keys(tmp_path / "again") <= {*answered}
    assert doctor_findings(tmp_path / "again").keys() <= {"token"}


def test_server_of_restored_backup_returns_the_same_boxes_and_images(
    filled, unghost, tmp_path
):
    backed_up(filled, tmp_path / "kept.tar")

    done = unghost("restore", "kept.tar", "--data", tmp_path / "again")
    with served(tmp_path / "again") as (_, api):
        name = api.json("/datasets")["items"][0]["name"]
        boxes = api.boxes(name)
        frames = {box["frame_id"] for box in boxes}
        pictures = {api.get(f"/frames/{frame}/image").content for frame in frames}

    assert done.code == 0, done.err
    assert sorted(box["verdict"] for box in boxes) == 2 * ["kept"] + 2 * ["rejected"]
    assert pictures == {scene.image(0), scene.image(1)}


@pytest.mark.parametrize("target", TARGETS)
def test_backup_has_no_token_and_only_its_owner_can_read_it(filled, tmp_path, target):
    secret = (filled / "token").read_bytes().strip()

    backup = backed_up(filled, tmp_path / target)

    files = [backup] if backup.is_file() else list(backup.rglob("*.*"))
    assert not [file for file in files if secret in file.read_bytes()]
    assert [file for file in files if file.stat().st_mode & 0o077] == []


def test_existing_backup_is_not_overwritten_and_failed_one_is_cleaned_up(
    filled, tmp_path
):
    kept = tmp_path / "kept"
    damaged = blobs(filled)[0]
    damaged.write_bytes(b"")
    (tmp_path / ".kept.partial" / "kept").mkdir(parents=True)  # of a killed process

    with pytest.raises(CannotMaintain, match=damaged.name):
        backed_up(filled, kept)
    backed_up(filled, kept, incomplete=True)
    with pytest.raises(CannotMaintain, match="exists already"):
        backed_up(filled, kept)

    assert len(blobs(kept)) == len(blobs(filled)) - 1
    label, _ = restored(kept, tmp_path / "again")
    assert label.left_out == (damaged.name,)
    assert [path.name for path in tmp_path.glob(".kept*")] == []


def test_second_concurrent_backup_is_refused(filled, tmp_path):
    with (
        locked(filled / MAINTENANCE_LOCK),
        pytest.raises(CannotMaintain, match="is running already"),
    ):
        backed_up(filled, tmp_path / "kept")


@pytest.mark.parametrize(
    "words", [("backup", "kept"), ("gc", "--grace", "0")], ids=["backup", "gc"]
)
def test_folder_without_locks_is_maintained_after_a_warning(filled, unghost, words):
    command = (*without_locks.COMMAND, "ENOLCK", "unghost.cli", *words)
    process = start_anew(command, unghost.folder, unghost.environ)
    _, errors = process.communicate(timeout=60)

    assert process.returncode == 0
    assert errors.splitlines()[0] == (
        f"the data folder {str(filled)!r} cannot be locked (No locks available): a "
        "backup or a garbage collection at the same time would not be refused, so "
        "start none"
    )


def damage_a_blob(kept):
    file = blobs(kept)[0]
    file.write_bytes(file.read_bytes()[:-1] + b"?")


def delete_a_blob(kept):
    blobs(kept)[0].unlink()


def delete_backup_json(kept):
    (kept / "backup.json").unlink()


def corrupt_the_database(kept):
    with (kept / "unghost.db").open("r+b") as file:
        file.seek(5000)
        file.write(b"\xff" * 64)


def add_an_unexpected_file(kept):
    (kept / "blobs" / "aa").mkdir(exist_ok=True)
    (kept / "blobs" / "aa" / "run.sh").write_text("no")


@pytest.mark.parametrize(
    "spoil",
    [
        damage_a_blob,
        delete_a_blob,
        delete_backup_json,
        corrupt_the_database,
        add_an_unexpected_file,
    ],
)
def test_damaged_or_incomplete_backup_is_not_restored(filled, tmp_path, spoil):
    kept = backed_up(filled, tmp_path / "kept")
    spoil(kept)

    with pytest.raises(CannotMaintain):
        restored(kept, tmp_path / "again")

    assert [*(tmp_path / "again").iterdir()] == []


def test_truncated_tar_is_not_restored(filled, tmp_path):
    whole = backed_up(filled, tmp_path / "kept.tar").read_bytes()
    cut = tmp_path / "cut.tar"

    for size in (0, 100, len(whole) // 2, len(whole) - 12_000):
        cut.write_bytes(whole[:size])
        with pytest.raises(CannotMaintain):
            restored(cut, tmp_path / "again")

    assert [*(tmp_path / "again").iterdir()] == []


@pytest.mark.parametrize("name", ["../evil", "/evil", "blobs/../../evil"])
def test_tar_with_path_traversal_is_not_restored(tmp_path, name):
    with tarfile.open(tmp_path / "evil.tar", "w") as archive:
        archive.addfile(tarfile.TarInfo(name))

    with pytest.raises(CannotMaintain, match="backups contain no"):
        restored(tmp_path / "evil.tar", tmp_path / "again")


def old_sparse_header(name, size):
    """A header of GNU tar's own type for a file that is one hole; it has no content."""
    member = tarfile.TarInfo(name)
    member.type = tarfile.GNUTYPE_SPARSE
    header = bytearray(member.tobuf(tarfile.GNU_FORMAT))
    number = b"%011o\0" % size
    header[386:398], header[398:410] = number, b"%011o\0" % 0
    header[483:495] = number
    header[148:156] = b" " * 8
    header[148:156] = b"%06o\0 " % sum(header)
    return bytes(header)


def new_sparse_header(name, size):
    """The same with the keywords of POSIX's format."""
    member = tarfile.TarInfo(name)
    member.pax_headers = {"GNU.sparse.size": str(size), "GNU.sparse.map": f"{size},0"}
    return member.tobuf(tarfile.PAX_FORMAT)


@pytest.mark.parametrize("header", [old_sparse_header, new_sparse_header])
@pytest.mark.parametrize("name", ["unghost.db", "backup.json"])
def test_tar_with_a_sparse_file_is_not_restored(tmp_path, header, name):
    content = header(name, 10**7)
    (tmp_path / "evil.tar").write_bytes(content + bytes(tarfile.BLOCKSIZE * 2))

    with pytest.raises(CannotMaintain, match=f"'{name}' is a sparse file"):
        restored(tmp_path / "evil.tar", tmp_path / "again")


@pytest.mark.parametrize("size", [4097, 10**6, -512])
@pytest.mark.parametrize("kind", [tarfile.XHDTYPE, tarfile.GNUTYPE_LONGNAME])
def test_tar_with_an_overlong_header_is_not_restored(tmp_path, kind, size):
    # Python's reader needs time by the square of its size: four seconds for 80 KB.
    header = tarfile.TarInfo("header")
    header.type, header.size = kind, size
    content = header.tobuf(tarfile.GNU_FORMAT) + b"9" * 10**5
    (tmp_path / "evil.tar").write_bytes(content)

    with pytest.raises(CannotMaintain, match=f"at most 4096 bytes, found {size}"):
        restored(tmp_path / "evil.tar", tmp_path / "again")


@pytest.mark.parametrize("target", TARGETS)
def test_backup_with_an_overlong_label_is_not_restored(tmp_path, target):
    folder, kept = tmp_path / "folder", tmp_path / target
    folder.mkdir()
    (folder / "unghost.db").write_bytes(b"")
    (folder / "backup.json").write_bytes(b" " * (MAX_LABEL_BYTES + 1))
    if kept.suffix:
        with tarfile.open(kept, "w") as archive:
            archive.add(folder / "backup.json", "backup.json")
    else:
        folder.rename(kept)

    with pytest.raises(CannotMaintain, match=r"its backup\.json is longer than"):
        restored(kept, tmp_path / "again")


def label_again(kept):
    """Give a backup the label of its changed database."""
    label = json.loads((kept / "backup.json").read_text())
    label["database_sha256"] = digest_of(kept / "unghost.db")
    (kept / "backup.json").write_text(json.dumps(label))


@pytest.mark.parametrize("name", ["again", "audit_log_no_update"])
def test_backup_whose_database_has_a_foreign_trigger_is_not_restored(
    filled, tmp_path, name
):
    kept = backed_up(filled, tmp_path / "kept")
    with closing(sqlite3.connect(kept / "unghost.db")) as database:
        database.execute("DROP TRIGGER audit_log_no_update")
        # A token of the backup's author would be valid for ever.
        database.execute(
            f"CREATE TRIGGER {name} AFTER UPDATE ON tokens BEGIN "
            "UPDATE tokens SET revoked_at = NULL; END"
        )
        database.commit()
    label_again(kept)

    with pytest.raises(CannotMaintain, match=f"the trigger '{name}' is not Unghost's"):
        restored(kept, tmp_path / "again")


COMPUTED = (
    "CREATE VIEW frame_files AS WITH RECURSIVE n(i) AS "
    "(SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 999) "
    "SELECT printf('%064d', i) AS sha256 FROM n"
)
LARGE = (
    "CREATE TABLE frame_files(x, sha256 AS (hex(zeroblob(5000)) || x)); "
    "INSERT INTO frame_files(x) VALUES (1), (2), (3)"
)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (COMPUTED, "frame_files or exports is no table"),
        (COMPUTED.replace("frame_files", "Frame_Files"), "or exports is no table"),
        (LARGE, "a file has no SHA-256"),
    ],
)
def test_backup_whose_database_computes_its_files_is_not_restored(
    filled, tmp_path, table, words
):
    kept = backed_up(filled, tmp_path / "kept")
    with closing(sqlite3.connect(kept / "unghost.db")) as database:
        database.execute("DROP VIEW readable_decisions")
        database.execute("DROP TABLE frame_files")
        database.executescript(table)
    label_again(kept)

    with pytest.raises(CannotMaintain, match=words) as refused:
        restored(kept, tmp_path / "again")

    assert len(str(refused.value)) < 300


def test_backup_that_is_larger_than_the_free_space_is_not_unpacked(filled, tmp_path):
    again, everything = tmp_path / "again", shutil.disk_usage(tmp_path).total
    kept = backed_up(filled, tmp_path / "kept.tar")
    settings = Settings(data=again, min_free_bytes=everything)
    with pytest.raises(CannotMaintain, match=f"{everything} have to stay free"):
        restore(settings, kept, silently)

    needed = 2 * shutil.disk_usage(tmp_path).free
    os.truncate(kept, needed)  # zeros after the end of an archive are ignored
    with pytest.raises(CannotMaintain, match=f"needs {needed} bytes, and .* are free"):
        restored(kept, again)

    assert list(again.iterdir()) == []


def test_restore_into_a_folder_that_is_not_empty_is_refused(filled, unghost, tmp_path):
    backed_up(filled, tmp_path / "kept")
    before = sorted(filled.rglob("*"))

    refused = unghost("restore", "kept")

    assert refused.code == 1
    assert "is not empty" in refused.err
    assert sorted(filled.rglob("*")) == before


def test_lock_files_of_a_server_do_not_prevent_a_restore(filled, tmp_path):
    again = tmp_path / "again"
    check_free(Settings(data=again, port=0))
    locks = {path.name for path in again.iterdir()}

    _, files = restored(backed_up(filled, tmp_path / "kept"), again)

    assert locks == {".server.lock", ".unghost.db.lock"}
    assert files == 4


def test_interrupted_restore_is_not_served_and_can_be_repeated(
    filled, unghost, tmp_path
):
    backed_up(filled, tmp_path / "kept")
    shutil.rmtree(filled)
    (filled / ".restoring").mkdir(parents=True)

    refused = unghost("serve", "--port", "0")

    assert refused.code == 1
    assert "run `unghost restore` again" in refused.err
    _, files = restored(tmp_path / "kept", filled)
    assert files == 4
    assert doctor_findings(filled).keys() <= {"token"}


@pytest.mark.parametrize("is_killed", [True, False])
def test_restore_that_moved_only_the_files_can_be_repeated(
    filled, tmp_path, monkeypatch, is_killed
):
    kept = backed_up(filled, tmp_path / "kept")
    again = tmp_path / "again"
    rename = Path.rename

    def fail_for_the_database(path, target):
        if path.name == "unghost.db":
            if is_killed:
                shutil.copytree(again, tmp_path / "as_left")
            raise OSError(errno.EIO, "cannot rename")
        return rename(path, target)

    with monkeypatch.context() as failing:
        failing.setattr(Path, "rename", fail_for_the_database)
        with pytest.raises(OSError, match="cannot rename"):
            restored(kept, again)
    if is_killed:
        assert list(again.iterdir()) == []
        again = tmp_path / "as_left"
        assert {path.name for path in again.iterdir()} == {".restoring", "blobs"}

    _, files = restored(kept, again)
    assert files == 4
    assert doctor_findings(again).keys() <= {"token"}


def test_files_of_a_service_beside_an_interrupted_restore_are_not_removed(
    filled, tmp_path
):
    # Its database is on a server, as with PostgreSQL.
    kept = backed_up(filled, tmp_path / "kept")
    (filled / "unghost.db").unlink()
    (filled / ".restoring").mkdir()

    with pytest.raises(CannotMaintain, match="is not empty"):
        restored(kept, filled)

    assert len(blobs(filled)) == 4


def test_backup_of_a_newer_schema_version_is_not_restored(filled, tmp_path):
    with closing(sqlite3.connect(filled / "unghost.db")) as database, database:
        database.execute("UPDATE alembic_version SET version_num = '9999'")
    kept = backed_up(filled, tmp_path / "kept")

    with pytest.raises(CannotMaintain, match="a newer Unghost wrote it"):
        restored(kept, tmp_path / "again")


def test_backup_and_restore_of_postgres_name_pg_dump_and_pg_restore(tmp_path):
    url = "postgresql+psycopg://nobody@127.0.0.1:1/none"
    settings = Settings(data=tmp_path / "data", database_url=url)

    with pytest.raises(CannotMaintain, match="pg_dump"):
        make_backup(settings, tmp_path / "kept", incomplete=False, steps=silently)
    with pytest.raises(CannotMaintain, match="pg_restore"):
        restore(settings, tmp_path, silently)
