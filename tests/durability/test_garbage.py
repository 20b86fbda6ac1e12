"""Garbage collection removes unreferenced files, but none that is being stored."""

import os
import threading
from itertools import count

import pytest

from app.catalog.datasets import DatasetRepository
from app.maintenance.datafolder import CannotMaintain
from app.maintenance.gc import collect
from app.settings import Settings
from app.storage.base import sha256_of
from app.storage.durable import MAINTENANCE_LOCK, locked
from app.storage.folder import FolderStorage
from tests.support import frames as scene
from tests.support.api import BASE
from tests.support.archives import frame, lines_of, send, tar_archive
from tests.support.data_folders import blobs, doctor_findings, served, silently
from tests.support.databases import empty_postgres, settings_of
from tests.support.services import ServiceDataset, running_services
from tests.support.waiting import until

pytestmark = pytest.mark.long

ROUNDS = int(os.environ.get("GARBAGE_ROUNDS", "10"))
LONG_AGO = 1_000_000_000


def collected(data, *, grace_hours=0.0, dry_run=False, **settings):
    chosen = Settings.model_validate({"data": data, **settings_of(data), **settings})
    return collect(chosen, grace_hours=grace_hours, dry_run=dry_run, steps=silently)


def set_old_mtime(*paths):
    for path in paths:
        os.utime(path, (LONG_AGO, LONG_AGO))


def delete_a_frame(data):
    """Delete one of the two frames, so that nothing refers to its two files."""
    with running_services(data) as services:
        with services.context.database.read() as session:
            (row,) = DatasetRepository(session).page(after="", limit=1)
        ServiceDataset(services, row.name, row.id).delete("f/0")


def test_files_of_a_deleted_frame_are_removed_and_others_kept(filled):
    delete_a_frame(filled)
    before = {path.name for path in blobs(filled)}

    only_looked = collected(filled, dry_run=True)
    looked = {path.name for path in blobs(filled)}
    garbage = collected(filled)

    assert looked == before
    assert (only_looked.files, garbage.files, garbage.rows) == (2, 2, 2)
    assert only_looked.size_bytes == garbage.size_bytes
    assert len(blobs(filled)) == 2
    assert doctor_findings(filled) == {}
    assert collected(filled).files == 0


def test_files_younger_than_the_grace_period_are_kept(filled):
    delete_a_frame(filled)

    kept = collected(filled, grace_hours=1)
    set_old_mtime(*blobs(filled))
    garbage = collected(filled, grace_hours=1)

    assert (kept.files, kept.too_young, kept.rows) == (0, 2, 0)
    assert (garbage.files, garbage.too_young) == (2, 0)


def test_old_leftovers_are_removed_and_young_ones_kept(filled):
    storage = FolderStorage(filled / "blobs")
    old, young = (
        storage.draft({sha256_of(data): data}).files[0][0] for data in (b"old", b"new")
    )
    export = storage.temporary_folder() / "export-77"
    export.mkdir()
    (export / "export.zip").write_bytes(b"half")
    set_old_mtime(old, export / "export.zip", export)

    assert doctor_findings(filled)["leftovers"].count == 2
    assert collected(filled).leftovers == 2
    assert (old.exists(), export.exists(), young.exists()) == (False, False, True)


def test_unused_file_that_is_uploaded_again_is_not_removed(filled):
    """The file still exists, so the upload only adds a reference to it."""
    delete_a_frame(filled)
    set_old_mtime(*blobs(filled))

    with running_services(filled) as services:
        services.dataset().put(
            "again",
            scene.annotation(),
            image=scene.image(0),
            segmentation=scene.segmentation(0),
        )
        garbage = collected(filled)

    assert garbage.files == 0
    assert doctor_findings(filled) == {}


def test_collection_during_a_backup_is_refused(filled):
    with (
        locked(filled / MAINTENANCE_LOCK),
        pytest.raises(CannotMaintain, match="is running already"),
    ):
        collected(filled)


def test_missing_data_folder_raises_an_error(tmp_path):
    with pytest.raises(CannotMaintain, match=r"no folder .*--data DIR or UNGHOST_DATA"):
        collected(tmp_path / "nowhere")


@pytest.mark.sqlite_files("its file is missing")
def test_folder_without_a_database_is_refused_and_keeps_its_files(filled):
    (filled / "unghost.db").unlink()

    with pytest.raises(CannotMaintain, match="no database"):
        collected(filled)

    assert len(blobs(filled)) == 4


def test_unused_files_and_rows_are_removed_with_postgres(tmp_path):
    with empty_postgres() as url:
        chosen = {"database_url": url}
        with running_services(tmp_path / "data", **chosen) as services:
            street = services.dataset()
            for key in ("a", "b"):
                street.put(key, scene.annotation(), image=scene.image(ord(key)))
            street.delete("a")

        garbage = collected(tmp_path / "data", **chosen)

        assert (garbage.files, garbage.rows, len(blobs(tmp_path / "data"))) == (1, 1, 1)
        assert doctor_findings(tmp_path / "data", **chosen) == {}


def test_concurrent_collection_without_grace_removes_no_file_in_use(tmp_path):
    """Frames that share files are deleted and sent again while garbage is collected.

    Without a grace period, files in use are protected only because transactions that
    write take turns.
    """
    data, over = tmp_path / "data", threading.Event()
    removed = []

    def collect_repeatedly():
        while not over.is_set():
            removed.append(collected(data, grace_hours=-1).files)

    with served(data) as (_, api):
        dataset = api.dataset()
        collecting = threading.Thread(target=collect_repeatedly)
        collecting.start()
        try:
            for number in count():
                delete_and_upload_again(api, dataset, number)
                if number >= ROUNDS and sum(removed) > 0:
                    break
        finally:
            over.set()
            collecting.join()
        kept = [
            item["key"] for item in api.json(f"/datasets/{dataset}/frames")["items"]
        ]

    assert sorted(kept) == ["f/one", "run/many"]
    assert doctor_findings(data) == {}


def delete_and_upload_again(api, dataset, number):
    """Delete both frames, which share files, and store them again: one in a batch."""
    for key in ("f/one", "run/many") if number else ():
        path = f"{BASE}/datasets/{dataset}/frames/{key}"
        assert api.http.delete(path).status_code == 204
    sent_until_stored(lambda: api.put(dataset, "f/one").status_code)
    sent_until_stored(lambda: batch(api, dataset))


def sent_until_stored(send):
    """Repeat a request while it is answered with 503; then it must be 201."""

    def answered():
        status = send()
        return status if status != 503 else None

    assert until(answered) == 201


def batch(api, dataset):
    response = send(api, dataset, tar_archive(frame("many")))
    assert response.status_code == 200, response.text
    return lines_of(response.text)[0]["status"]
