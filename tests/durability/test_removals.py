"""A deleted dataset cannot be read any more; its rows are deleted in parts.

That continues after a kill.
"""

import signal
from contextlib import suppress
from typing import NamedTuple

import httpx
import pytest

from tests.support.api import Api
from tests.support.crash_points import Point, client_of, crashing_servers
from tests.support.data_folders import count, served
from tests.support.databases import problems_of
from tests.support.large_datasets import DatasetSpec, make_dataset
from tests.support.live import hold_writes, live
from tests.support.services import running_services
from tests.support.waiting import until

FRAMES, BOXES_PER_FRAME = 240, 50
PORTIONS = 1000
"""More than a removal has."""
NAME = "large"
TABLES = (
    *("frames", "boxes", "decisions", "evidence", "reviews", "claims", "problems"),
    *("runs", "flips", "tallies", "exports", "measurements", "config_versions"),
    *("dataset_classes", "datasets", "review_batches", "chunks", "leases"),
)


class Ids(NamedTuple):
    """Ids of rows of the dataset that is deleted."""

    frame: int
    box: int
    run: int
    export: int
    batch: int
    config: str

    def paths(self):
        """URL paths that have an id instead of the dataset's name."""
        return (
            f"/frames/{self.frame}",
            f"/frames/{self.frame}/overlay",
            f"/boxes/{self.box}",
            f"/boxes/{self.box}/history",
            f"/boxes/{self.box}/crop",
            f"/runs/{self.run}",
            f"/runs/{self.run}/diff?against={self.run}",
            f"/exports/{self.export}",
            f"/exports/{self.export}/download",
            f"/configs/{self.config}",
        )


@pytest.fixture
def data(tmp_path):
    """A data folder, not served yet; its dataset is removed in several parts."""
    folder = tmp_path / "data"
    with running_services(folder) as services:
        make_dataset(
            services.context, DatasetSpec(NAME, FRAMES, BOXES_PER_FRAME), lambda _: None
        )
    return folder


@pytest.fixture
def held(data):
    """A client of the data's service, and the permits to remove a portion each."""
    with (
        live(data) as service,
        service.admin() as http,
        hold_writes("removals") as permits,
    ):
        yield Api(http), permits


def add_one_row_of_each_kind(api):
    """Add a frame, a refused one, a review, a run and an export; returns their ids."""
    api.upload_frame(NAME, "one")
    refused = api.put(NAME, "refused", {"boxes": [{"class": "car"}]})
    assert refused.status_code == 422
    # The newest frame, because frames are removed in the order of their ids.
    newest = api.json(f"/datasets/{NAME}/frames/one")
    box = newest["boxes"][0]["box_id"]
    body = {"dataset": NAME, "box_ids": [box], "verdict": "keep"}
    batch = api.post("/reviews/bulk", body).json()
    run = api.run(NAME, {"threshold_small_box": 30})
    accepted = api.post(f"/datasets/{NAME}/exports", {"format": "yolo"})
    export = api.wait_for_job(accepted)
    config = api.json(f"/datasets/{NAME}")["config"]
    return Ids(newest["id"], box, run["id"], export["id"], batch["id"], config)


def test_deleted_dataset_returns_404_before_its_rows_are_removed(data, held):
    api, permits = held
    ids = add_one_row_of_each_kind(api)
    stored = count(data)

    api.remove(NAME)
    statuses = {path: api.get(path).status_code for path in ids.paths()}
    status = api.review(ids.box, "reject", 1).status_code
    undone = api.post(f"/review-batches/{ids.batch}/undo").status_code
    again = api.post("/datasets", {"name": NAME}).status_code
    metrics = api.http.get("/metrics").text
    left = count(data)
    permits.release(PORTIONS)

    until(lambda: count(data) == 0)
    assert api.json(f"/datasets/{NAME}")["counts"]["frames"] == 0
    assert left == stored
    assert statuses == dict.fromkeys(ids.paths(), 404)
    assert (status, undone, again) == (404, 404, 201)
    assert "unghost_datasets 1.0\n" in metrics
    assert 'unghost_jobs{kind="export",state="done"} 0' in metrics


@pytest.mark.long
def test_removal_interrupted_by_a_kill_is_finished_by_the_next_server(data):
    # The first commit is that of the request.
    point = Point("commit", after=True, turn=5)
    with crashing_servers(data) as servers, client_of(servers.server(point)) as api:
        add_one_row_of_each_kind(api)
        stored = count(data)
        servers.arm()
        with suppress(httpx.TransportError):
            api.remove(NAME)
        assert servers.wait_for_exit(ask=False) == -signal.SIGKILL
    between = count(data)

    with served(data) as (_, api):
        missing = api.get(f"/datasets/{NAME}").status_code
        listed = api.json("/datasets")["items"]
        until(lambda: count(data, "datasets") == 0)
        log = api.json("/audit")["items"]

    assert 0 < between < stored
    assert missing == 404
    assert listed == []
    assert {table: count(data, table) for table in TABLES} == dict.fromkeys(TABLES, 0)
    assert [entry["action"] for entry in log].count("dataset.deleted") == 1
    assert problems_of(data) == []


def test_reviews_are_stored_between_two_portions_of_a_removal(data, held):
    api, permits = held
    add_one_row_of_each_kind(api)
    beside = api.dataset()
    api.upload_frame(beside, "a")
    box, *others = api.boxes(beside)
    stored = count(data)

    api.remove(NAME)
    permits.release()
    until(lambda: count(data) < stored)
    responses = [
        api.review(box["box_id"], "keep", seen, comment=str(seen)) for seen in range(3)
    ]
    left = count(data)
    permits.release(PORTIONS)

    until(lambda: count(data) == 1 + len(others))
    assert [response.status_code for response in responses] == [201] * 3
    assert left > 1 + len(others)
