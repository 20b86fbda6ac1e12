"""A real service, over a real port, that keeps all its files in a bucket."""

import hashlib

import pytest

from tests.support import frames as scene
from tests.support.api import BASE
from tests.support.archives import frame, lines_of, send, tar_archive
from tests.support.servers import wait_until_ready
from tests.support.slow_datasets import FROM_PIXELS
from tests.support.waiting import until

FRAMES = 3
HOUR_S = 3600


def batch(api, dataset, *names):
    members = [
        file for number, name in enumerate(names) for file in frame(name, number=number)
    ]
    response = send(api, dataset, tar_archive(members))
    assert response.status_code == 200, response.text
    return lines_of(response.text)


def upload_dataset(api):
    """A dataset of frames that came one by one and in a batch."""
    dataset = api.dataset()
    for number in range(FRAMES):
        api.upload_frame(
            dataset,
            f"one/{number}",
            image=scene.image(number),
            segmentation=scene.segmentation(number),
        )
    *told, end = batch(api, dataset, "a", "b", "c")
    assert [line["status"] for line in told] == [201] * 3
    assert end["stored"] == 3
    return dataset


def make_export(api, dataset, **options):
    body = {"format": "yolo", "options": options}
    return api.wait_for_job(api.post(f"/datasets/{dataset}/exports", body))


@pytest.fixture(scope="module")
def dataset(on_s3):
    return upload_dataset(on_s3.api)


def test_files_are_in_the_bucket_by_digest_and_not_in_the_data_folder(on_s3, dataset):
    api = on_s3.api
    frames = api.json(f"/datasets/{dataset}/frames")["items"]
    pictures = [api.get(f"/frames/{each['id']}/image") for each in frames]

    digests = {hashlib.sha256(response.content).hexdigest() for response in pictures}
    keys = {f"some/where/{digest[:2]}/{digest}" for digest in digests}
    assert len(frames) == 2 * FRAMES
    assert keys <= {*on_s3.bucket.keys()}
    stored_here = [
        path for path in on_s3.server.data.rglob("*") if len(path.name) == 64
    ]
    assert stored_here == []


def test_pictures_are_drawn_and_frames_measured_from_the_bucket(on_s3):
    dataset = upload_dataset(on_s3.api)
    box = on_s3.api.boxes(dataset)[0]
    frame_path = f"/frames/{box['frame_id']}"

    run = on_s3.api.run(dataset, FROM_PIXELS)

    assert (run["state"], run["done"]) == ("done", 2 * FRAMES)
    for path in (
        f"{frame_path}/thumbnail",
        f"{frame_path}/overlay",
        f"/boxes/{box['box_id']}/crop",
    ):
        response = on_s3.api.get(path)
        assert response.status_code == 200, response.text
        assert response.headers["content-type"] in ("image/webp", "image/png")


def test_reupload_of_a_frame_repairs_its_damaged_and_missing_files(on_s3):
    api, bucket = on_s3.api, on_s3.bucket
    dataset = api.dataset()
    content = scene.image(77)
    digest = hashlib.sha256(content).hexdigest()
    files = {"image": content, "segmentation": scene.segmentation()}
    stored = api.upload_frame(dataset, "k", **files)
    path = f"/frames/{stored['frame']['id']}/image"

    bucket.overwrite(digest, content[:-1])
    damaged = api.get(path)
    bucket.delete(digest)
    gone = api.get(path)
    api.upload_frame(dataset, "k", **files)

    assert (damaged.status_code, damaged.json()["code"]) == (500, "damaged_file")
    assert (gone.status_code, gone.json()["code"]) == (500, "damaged_file")
    assert api.get(path).content == content


def test_export_in_the_bucket_supports_range_and_if_range(on_s3, dataset):
    made = make_export(on_s3.api, dataset, images="copy")
    whole = on_s3.api.http.get(made["download"])
    tag, size = whole.headers["etag"], made["size_bytes"]

    first = on_s3.api.http.get(made["download"], headers={"Range": "bytes=0-999"})
    rest = on_s3.api.http.get(
        made["download"], headers={"Range": "bytes=1000-", "If-Range": tag}
    )
    stale = on_s3.api.http.get(
        made["download"], headers={"Range": "bytes=1000-", "If-Range": '"other"'}
    )

    assert made["state"] == "done"
    assert tag == f'"{made["sha256"]}"'
    assert [part.status_code for part in (first, rest, stale)] == [206, 206, 200]
    assert rest.headers["content-range"] == f"bytes 1000-{size - 1}/{size}"
    assert hashlib.sha256(first.content + rest.content).hexdigest() == made["sha256"]
    assert first.content + rest.content == whole.content == stale.content
    assert made["sha256"] in on_s3.bucket.blobs()


def test_readyz_and_metrics_report_the_files_of_the_bucket(on_s3, dataset):
    ready = wait_until_ready(on_s3.server.url).json()
    until(lambda: "\nunghost_blob_bytes " in on_s3.api.http.get("/metrics").text)
    text = on_s3.api.http.get("/metrics").text

    assert ready["checks"]["blobs"] == "writable"
    counted = text.partition("\nunghost_blobs ")[2].split()[0]
    assert float(counted) > FRAMES


def test_garbage_collection_removes_old_unused_files_of_the_bucket(on_s3, s3):
    api, command, dataset = on_s3.api, on_s3.command, on_s3.api.dataset()
    images = {"old": scene.image(99), "young": scene.image(98)}
    digests = {key: hashlib.sha256(image).hexdigest() for key, image in images.items()}
    with s3.at_another_time(-25 * HOUR_S):
        api.upload_frame(dataset, "old", image=images["old"])
    api.upload_frame(dataset, "young", image=images["young"])
    for key in images:
        api.http.delete(f"{BASE}/datasets/{dataset}/frames/{key}")

    collected = command("gc", "--json")
    doctor = command("doctor", "--verify", "--json")

    assert (collected.code, doctor.code) == (0, 0), collected.err + doctor.out
    (told,) = collected.records
    assert (told["files"], told["too_young"]) == (1, 1)
    assert digests["old"] not in on_s3.bucket.blobs()
    assert digests["young"] in on_s3.bucket.blobs()
    findings = {record["check"]: record for record in doctor.records}
    assert findings["store"]["severity"] == "ok"
    assert findings["files"]["found"] == "all match their hashes"
