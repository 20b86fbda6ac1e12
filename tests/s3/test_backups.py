"""A backup of files in a bucket can be restored to a bucket or to a folder."""

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
def filled_bucket(tmp_path, s3):
    """The bucket with the files of a data folder that has two frames."""
    bucket = s3.bucket()
    filled_folder(tmp_path / "data", **bucket.settings)
    return bucket


def back_up(tmp_path, bucket, name="kept.tar", *, incomplete=False):
    chosen = settings(tmp_path / "data", bucket)
    return make_backup(chosen, tmp_path / name, incomplete=incomplete, steps=silently)


@pytest.mark.parametrize("name", ["kept", "kept.tar"])
def test_backup_of_a_bucket_is_restored_to_another_bucket_or_to_a_folder(
    tmp_path, s3, filled_bucket, name
):
    kept = back_up(tmp_path, filled_bucket, name)
    other = s3.bucket()

    _, files = restore(settings(tmp_path / "again", other), kept.path, silently)
    restore(settings(tmp_path / "folder"), kept.path, silently)

    assert (kept.files, files) == (4, 4)
    assert other.blobs() == filled_bucket.blobs()
    with running_services(tmp_path / "again", **other.settings):
        assert doctor_findings(tmp_path / "again", **other.settings) == {}
    assert doctor_findings(tmp_path / "folder").keys() <= {"token"}


def test_backup_with_a_damaged_blob_fails_or_omits_it(tmp_path, filled_bucket):
    damaged = filled_bucket.blobs()[0]
    filled_bucket.overwrite(damaged, b"?")

    with pytest.raises(CannotMaintain, match=damaged):
        back_up(tmp_path, filled_bucket)
    kept = back_up(tmp_path, filled_bucket, incomplete=True)

    assert kept.left_out == (damaged,)


def test_restore_repairs_its_own_bucket_but_refuses_one_with_other_files(
    tmp_path, s3, filled_bucket
):
    kept = back_up(tmp_path, filled_bucket)
    before = filled_bucket.blobs()
    filled_bucket.delete(before[0])
    filled_bucket.overwrite(before[1], b"?")

    restore(settings(tmp_path / "again", filled_bucket), kept.path, silently)
    with running_services(tmp_path / "data", **filled_bucket.settings) as services:
        services.context.storage.put({"0" * 64: b"newer"})
    with pytest.raises(CannotMaintain, match="1 files there are not in the backup"):
        restore(settings(tmp_path / "third", filled_bucket), kept.path, silently)

    assert doctor_findings(tmp_path / "again", **filled_bucket.settings).keys() <= {
        "token"
    }
    assert {*before} < {*filled_bucket.blobs()}
    assert [*(tmp_path / "third").iterdir()] == []


def test_backup_with_a_bucket_and_postgresql_is_refused(tmp_path, s3):
    chosen = {**s3.bucket().settings, "database_url": "postgresql://a@127.0.0.1:1/b"}

    with pytest.raises(CannotMaintain, match="let its bucket keep versions"):
        make_backup(
            Settings.model_validate({"data": tmp_path, **chosen}),
            tmp_path.with_name("kept"),
            incomplete=False,
            steps=silently,
        )
