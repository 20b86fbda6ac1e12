"""Full and read-only disks, damaged and missing files: responses and recovery."""

import pytest

from tests.support import frames as scene
from tests.support.data_folders import blobs, doctor_findings, served
from tests.support.mounts import read_only, small_disk
from tests.support.servers import start

pytestmark = pytest.mark.long

NO_MINIMUM = {"UNGHOST_MIN_FREE_BYTES": "0"}


def log_of_failed_start(data, tmp_path):
    """The log of a server that must exit with status 1 instead of starting."""
    log = tmp_path / "refused.log"
    with start(["app"], data, log, {}) as process:
        assert process.wait(120) == 1
    return log.read_text("utf-8")


@pytest.mark.sqlite_files("its file is damaged, missing or on a small disk")
def test_full_disk_returns_503_loses_nothing_and_recovers_when_space_is_free(tmp_path):
    with small_disk(tmp_path / "disk", 24) as disk:
        data = disk / "data"
        with served(data, **NO_MINIMUM) as (_, api):
            dataset = api.dataset()
            first = api.upload_frame(dataset, "first")["decisions"][0]["box_id"]
            stored, full = upload_until_disk_is_full(api, dataset, disk)
            review = api.review(first, "reject")
            shown = api.json(f"/boxes/{first}")
            (disk / "filler").unlink()
            again = api.put(dataset, "again", image=scene.image(255))
            reviewed = api.review(first, "reject")
        with served(data, **NO_MINIMUM) as (_, api):
            items = api.json(f"/datasets/{dataset}/frames", limit=1000)["items"]

        assert (full.status_code, full.json()["code"]) == (503, "storage_full")
        assert int(full.headers["Retry-After"]) > 0
        assert (review.status_code, shown["review"]) == (503, None)
        assert (again.status_code, reviewed.status_code) == (201, 201)
        assert {item["key"] for item in items} == {"first", "again", *stored}
        assert doctor_findings(data, min_free_bytes=0) == {}


def upload_until_disk_is_full(api, dataset, disk):
    """Upload frames while the disk is filled.

    Returns the keys of the stored frames, and the first response that refused one.
    """
    with (disk / "filler").open("wb", buffering=0) as filler:
        stored: list[str] = []
        for number in range(1000):
            try:
                filler.write(bytes(1 << 20))
                filler.write(bytes(1 << 20))
            except OSError:
                pass
            key = f"f/{number}"
            response = api.put(dataset, key, image=scene.image(number))
            if response.status_code != 201:
                return stored, response
            stored.append(key)
    raise AssertionError("the disk was never full")


@pytest.mark.sqlite_files("its file is damaged, missing or on a small disk")
def test_read_only_data_folder_returns_storage_read_only(tmp_path):
    data = tmp_path / "data"
    with served(data) as (_, api):
        dataset = api.dataset()
        api.upload_frame(dataset, "first")
        with read_only(data):
            refused = api.put(dataset, "second", image=scene.image(2))
            shown = api.boxes(dataset)
        again = api.put(dataset, "second", image=scene.image(2))

    assert (refused.status_code, refused.json()["code"]) == (503, "storage_read_only")
    assert (len(shown), again.status_code) == (2, 201)
    with read_only(data):
        said = log_of_failed_start(data, tmp_path)
        assert doctor_findings(data) == {}
    assert "could not start with the data folder" in said.splitlines()[-1]


def test_damaged_files_return_500_with_their_name_and_reupload_repairs_them(tmp_path):
    data, image = tmp_path / "data", scene.image(7)
    with served(data) as (_, api):
        dataset = api.dataset()
        files = {"image": image, "segmentation": scene.segmentation()}
        frame = api.upload_frame(dataset, "f", **files)["frame"]["id"]
        cut, flipped = sorted(blobs(data), key=lambda file: file.read_bytes() != image)
        cut.write_bytes(image[:-1])
        flipped.write_bytes(flipped.read_bytes()[:-1] + b"?")

        picture = api.get(f"/frames/{frame}/image")
        overlay = api.get(f"/frames/{frame}/overlay", layer="segmentation")
        original = api.get(f"/frames/{frame}/segmentation")
        run = api.run(dataset, {"profile": "carlasimu"})
        flipped.unlink()
        api.upload_frame(dataset, "f", **files)
        mended = api.get(f"/frames/{frame}/image")

    for response, file in ((picture, cut), (overlay, flipped), (original, flipped)):
        assert (response.status_code, response.json()["code"]) == (500, "damaged_file")
        assert file.name in response.json()["detail"]
        assert str(data) not in response.text
    assert (run["state"], run["error"]["code"]) == ("failed", "damaged_file")
    assert mended.content == image
    assert doctor_findings(data) == {}


@pytest.mark.sqlite_files("its file is damaged, missing or on a small disk")
def test_server_does_not_start_when_the_database_is_missing(filled, tmp_path):
    """With a new, empty database, all files would count as garbage."""
    (filled / "unghost.db").unlink()

    said = log_of_failed_start(filled, tmp_path)

    assert "is missing, but its files still exist" in said.splitlines()[-1]
    assert "restore a backup" in said.splitlines()[-1]
    assert not (filled / "unghost.db").exists()
    assert len(blobs(filled)) == 4
