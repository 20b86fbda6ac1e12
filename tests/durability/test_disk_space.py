"""On a disk with too little space, uploads are refused, but deletions still work."""

import json
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from shutil import copytree, ignore_patterns

import httpx
import pytest
from sqlalchemy import text

from app.storage.room import RESERVE
from tests.support.archives import frame, send, tar_archive
from tests.support.data_folders import blobs, count, served
from tests.support.databases import database_of
from tests.support.large_datasets import DatasetSpec, make_dataset
from tests.support.mounts import small_disk
from tests.support.servers import start, stop, wait_until_ready
from tests.support.services import running_services
from tests.support.waiting import until

pytestmark = pytest.mark.sqlite_files("its database shares the small disk")

DISK_MIB, MIN_FREE_MIB = 128, 16
NAME = "large"
MIB = 1024**2
NOT_REMOVED_YET = "cannot remove the rows of deleted datasets yet"
SETTINGS = {"UNGHOST_MIN_FREE_BYTES": f"{MIN_FREE_MIB}MiB"}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A data folder with a dataset whose removal takes long, to copy."""
    folder = tmp_path_factory.mktemp("made") / "data"
    with running_services(folder, min_free_bytes=0) as services:
        make_dataset(services.context, DatasetSpec(NAME, 400, 50), lambda _: None)
    return folder


@pytest.fixture
def data(made, tmp_path):
    """A data folder on a small disk, with a dataset whose removal takes long."""
    with small_disk(tmp_path / "disk", DISK_MIB) as disk:
        folder = disk / "data"
        copytree(made, folder, ignore=ignore_patterns(RESERVE))
        yield folder


def has_reserve(data):
    """Whether the reserve has its space, which it gets after its name."""
    path = data / RESERVE
    return path.exists() and path.stat().st_size > 0


@contextmanager
def full_disk(data, leaving_bytes):
    """Fill the disk until the block ends; `leaving_bytes` stay free."""
    filler = data.parent / "filler"
    with filler.open("wb", buffering=0) as file:
        for piece in (MIB, 4096):
            with suppress(OSError):  # the disk is full, as intended
                while file.write(bytes(piece)) == piece:
                    pass
        file.truncate(file.tell() - leaving_bytes)
    try:
        yield
    finally:
        filler.unlink()


def test_below_min_free_bytes_only_reviews_and_descriptions_are_stored(data):
    corner = {"polygons": [[[0, 0], [9, 0], [9, 9]]]}
    with served(data, **SETTINGS) as (_, api):
        beside = api.dataset_of_one_frame()
        path = f"/datasets/{beside}"
        config = api.json(f"{path}/config")["config"]
        (box, *_) = api.boxes(beside)
        with full_disk(data, MIN_FREE_MIB * MIB // 2):
            storing = [
                api.put(beside, "c"),
                send(api, beside, tar_archive(frame("b"))),
                api.post(f"{path}/exports", {"format": "yolo"}),
                api.post("/datasets", {"name": "another"}),
                api.http.patch(f"/api/v1{path}", json={"ignore_mask": corner}),
                api.post(f"{path}/configs", {**config, "threshold_small_box": 31}),
            ]
            described = api.http.patch(f"/api/v1{path}", json={"description": "small"})
            review = api.review(box["box_id"], "keep")
        again = api.put(beside, "c")

    for refused in storing:
        problem = refused.json()
        assert (refused.status_code, problem["code"]) == (503, "storage_full")
        assert f"{MIN_FREE_MIB * MIB} have to stay free" in problem["detail"]
        assert int(refused.headers["retry-after"]) > 0
    assert described.status_code == 200
    assert (review.status_code, again.status_code) == (201, 201)


def test_below_a_quarter_of_min_free_bytes_answers_on_single_boxes_are_refused(data):
    with served(data, **SETTINGS) as (_, api):
        first, second = api.box_ids(NAME, limit=2)
        path = f"/api/v1/boxes/{first}/reviews"
        send_once = partial(
            api.http.post,
            path,
            json={"verdict": "keep", "seen_revision": 0},
            headers={"Idempotency-Key": "once"},
        )
        stored = send_once()
        with full_disk(data, MIN_FREE_MIB * MIB // 8):
            before = count(data, "reviews")
            response = api.review(second, "reject")
            undo = api.http.post(f"{path}/1/undo")
            repeated = send_once()
            after = count(data, "reviews")
        again = api.review(second, "reject")

    for refused in (response, undo):
        assert (refused.status_code, refused.json()["code"]) == (503, "storage_full")
        least = MIN_FREE_MIB * MIB // 4
        assert f"{least} have to stay free" in refused.json()["detail"]
        assert int(refused.headers["retry-after"]) > 0
    assert (repeated.status_code, repeated.json()) == (201, stored.json())
    assert (after, again.status_code) == (before, 201)


def test_bulk_answers_and_their_undo_need_room_for_all_their_comments(data):
    """A comment of two kilobytes on a thousand boxes takes some megabytes."""
    comment = "x" * 2000
    with served(data, **SETTINGS) as (_, api):
        boxes = api.box_ids(NAME, limit=1000)
        body = {"dataset": NAME, "box_ids": boxes, "verdict": "reject"}
        stored = api.post("/reviews/bulk", body)
        seen = {**body, "seen_revisions": [1] * len(boxes), "comment": comment}
        with full_disk(data, (MIN_FREE_MIB + 3) * MIB):
            before = count(data, "reviews")
            large = api.post("/reviews/bulk", seen)
            undo = api.post(f"/review-batches/{stored.json()['id']}/undo")
            review = api.review(boxes[0], "keep", seen=1)
            after = count(data, "reviews")
        undone = api.post(f"/review-batches/{stored.json()['id']}/undo")

    assert stored.status_code == 201, stored.text
    for refused in (large, undo):
        assert (refused.status_code, refused.json()["code"]) == (503, "storage_full")
        assert "this needs up to" in refused.json()["detail"]
    assert (review.status_code, after - before) == (201, 1)
    assert undone.status_code == 200, undone.text


def test_full_disk_still_allows_deletion_and_garbage_collection(data, unghost):
    with served(data, **SETTINGS) as (_, api):
        small = api.dataset()
        api.upload_frame(small, "a")
        until(lambda: has_reserve(data))
        with full_disk(data, 0):
            looked = unghost("gc", "--data", data, "--dry-run")
            untouched = (data / RESERVE).exists()
            full = api.put(small, "b").status_code
            api.remove(NAME)
            gone = api.http.delete(f"/api/v1/datasets/{small}?confirm={small}")
            until(lambda: count(data, "datasets") == 0)
            collected = unghost("gc", "--data", data, "--grace", "0", "--json")
            left = blobs(data)
        stored = api.post("/datasets", {"name": NAME}).status_code
        until(lambda: has_reserve(data))

    assert (looked.code, untouched) == (0, True), looked.err
    assert (full, gone.status_code, stored) == (503, 204, 201)
    assert collected.code == 0, collected.err
    assert json.loads(collected.out)["files"] == 2
    assert left == []


@pytest.mark.long
def test_deletion_on_a_full_disk_resumes_when_no_reader_holds_the_log(data):
    with served(data, **SETTINGS) as (server, api):
        until(lambda: has_reserve(data))
        with full_disk(data, 0):
            with database_of(data) as reader:
                reader.execute(text("SELECT 1 FROM datasets"))
                api.remove(NAME)
                until(lambda: NOT_REMOVED_YET in server.log.read_text("utf-8"))
            until(lambda: count(data, "datasets") == 0)


def grow_log(api):
    """Write pages to the database's log that its file has no place for yet."""
    boxes = api.box_ids(NAME, limit=1000)
    body = {"dataset": NAME, "box_ids": boxes, "verdict": "keep"}
    answered = api.post("/reviews/bulk", {**body, "comment": "x" * 2000})
    assert answered.status_code == 201, answered.text


@pytest.mark.long
def test_removals_resume_and_reserve_returns_after_a_full_disk_without_it(data):
    with served(data, **SETTINGS) as (server, api):
        grow_log(api)
        until(lambda: has_reserve(data))
        (data / RESERVE).unlink()
        with full_disk(data, 0):
            until(lambda: NOT_REMOVED_YET in server.log.read_text("utf-8"))
            refused = api.http.get("/readyz").json()
        wait_until_ready(server.url)
        api.remove(NAME)
        until(lambda: count(data, "datasets") == 0)
        until(lambda: has_reserve(data))
        ready = wait_until_ready(server.url).json()

    faults = {fault["code"]: fault["detail"] for fault in refused["errors"]}
    assert faults["background"] == f"{NOT_REMOVED_YET}: database or disk is full"
    assert ready["checks"]["background"] == "working"


@pytest.mark.long
def test_failed_start_on_a_full_disk_ends_and_the_next_one_continues(data, tmp_path):
    """Clients are waiting, as after a crash."""
    log, statuses = tmp_path / "log", set[int]()
    with served(data, **SETTINGS) as (server, api):
        grow_log(api)
        until(lambda: has_reserve(data))
        (data / RESERVE).unlink()
        with full_disk(data, 0):
            server.process.kill()
            server.process.wait()
            same_port = {"UNGHOST_PORT": server.url.rpartition(":")[2]}
            with start(["app"], data, log, {**SETTINGS, **same_port}) as process:

                def ask() -> None:
                    while process.poll() is None:
                        with suppress(httpx.TransportError):
                            statuses.add(api.get("/datasets").status_code)

                with ThreadPoolExecutor(2) as clients:
                    try:
                        for _ in range(2):
                            clients.submit(ask)
                        code = process.wait(60)
                    finally:
                        stop(process)
    with served(data, **SETTINGS):
        until(lambda: has_reserve(data))
        reviews = count(data, "reviews")

    *_, said = log.read_text("utf-8").splitlines()
    assert code == 1
    assert "Traceback" not in log.read_text("utf-8")
    assert said.startswith(f"the service could not start with the data folder '{data}'")
    assert "database or disk is full" in said
    assert statuses <= {200, 503}
    assert reviews == 1000


@pytest.mark.long
def test_reserve_is_used_only_by_a_deletion_that_needs_space(data):
    with served(data, **SETTINGS) as (_, api):
        name = api.dataset()
        api.upload_frame(name, "a")
        token = api.post("/tokens", {"name": "ada", "role": "viewer"}).json()["id"]
        until(lambda: has_reserve(data))
        with full_disk(data, 0):
            absent = [
                api.delete(path).status_code
                for path in (
                    f"/datasets/{name}/frames/b",
                    "/datasets/nowhere?confirm=nowhere",
                    f"/datasets/{name}",
                    "/tokens/999",
                    "/session",
                )
            ]
            kept = [(data / RESERVE).exists()]
        with full_disk(data, 6 * MIB):
            revoked = api.delete(f"/tokens/{token}").status_code
            kept.append((data / RESERVE).exists())
        with full_disk(data, 0):
            deleted = api.delete(f"/datasets/{name}/frames/a").status_code
            kept.append((data / RESERVE).exists())
        until(lambda: has_reserve(data))

    assert absent[:4] == [404, 404, 400, 404]
    assert (revoked, deleted, kept) == (204, 204, [True, True, False])
