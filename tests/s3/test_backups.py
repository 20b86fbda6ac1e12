"""A backup of files in a bucket can be restored to a bucket or to a folder."""

from __future__ import annotations

import pytest

from app.maintenance.backup import make_backup
from app.maintenance.datafolder import CannotMaintain
from app.maintenance.restore import restore
from app.settings import Settings
from tests.support.data_folders import doctor_findings, silently
from tests.support.services import filled_folder, running_services

pytestmark = pytest.mark.sqlite_files("a backup copies SQLite's file")


def settings(data, bucket=None):
    chosen = bucket.settings if bucket else {}
    return Settings.model_validate({"data": data, **chosen})


@pytest.fixture
def filled(tmp_path, s3):
    """The bucket with the files of a data folder that has two frames."""
    bucket = s3.bucket()
    filled_folder(tmp_path / "data", **bucket.settings)
    return bucket


def backed_up(tmp_path, bucket, name="kept.tar", *, incomplete=False):
    chosen = settings(tmp_path / "data", bucket)
    return make_backup(chosen, tmp_path / name, incomplete=incomplete, steps=silently)


@pytest.mark.parametrize("name", ["kept", "kept.tar"])
def test_a_backup_becomes_another_bucket(tmp_path, s3, filled, name):
    kept = backed_up(tmp_path, filled, name)
    other = s3.bucket()

    done = restore(settings(tmp_path / "again", other), kept.path, silently)

    assert (kept.files, done.files) == (4, 4)
    assert other.blobs() == filled.blobs()
    with running_services(tmp_path / "again", **other.settings):
        assert doctor_findings(tmp_path / "again", **other.settings) == {}


def test_a_backup_of_a_bucket_becomes_a_folder(tmp_path, filled):
    kept = backed_up(tmp_path, filled)

    restore(settings(tmp_path / "again"), kept.path, silently)

    assert doctor_findings(tmp_path / "again").keys() <= {"token"}


def test_a_damaged_file_is_named_or_left_out(tmp_path, filled):
    damaged = filled.blobs()[0]
    filled.overwrite(damaged, b"?")

    with pytest.raises(CannotMaintain, match=damaged):
        backed_up(tmp_path, filled)
    kept = backed_up(tmp_path, filled, incomplete=True)

    assert kept.left_out == (damaged,)


def test_the_same_bucket_is_mended_but_nobody_elses_files_are_taken_over(
    tmp_path, s3, filled
):
    kept = backed_up(tmp_path, filled)
    before = filled.blobs()
    filled.delete(before[0])
    filled.overwrite(before[1], b"?")

    restore(settings(tmp_path / "again", filled), kept.path, silently)
    with running_services(tmp_path / "data", **filled.settings) as services:
        services.context.storage.put({"0" * 64: b"newer"})
    with pytest.raises(CannotMaintain, match="1 files that are not in the backup"):
        restore(settings(tmp_path / "third", filled), kept.path, silently)

    assert doctor_findings(tmp_path / "again", **filled.settings).keys() <= {"token"}
    assert {*before} < {*filled.blobs()}
    assert [*(tmp_path / "third").iterdir()] == []


def test_a_bucket_beside_postgresql_is_saved_by_its_own_means(tmp_path, s3):
    chosen = {**s3.bucket().settings, "database_url": "postgresql://a@127.0.0.1:1/b"}

    with pytest.raises(CannotMaintain, match="let its bucket keep versions"):
        make_backup(
            Settings.model_validate({"data": tmp_path, **chosen}),
            tmp_path.with_name("kept"),
            incomplete=False,
            steps=silently,
        )
