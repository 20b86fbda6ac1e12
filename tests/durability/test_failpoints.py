"""A server is killed at a chosen point of its work; what it had answered is kept.

Frames and reviews are then stored completely or not at all. By default only some of the
points are tried; ``make test-long`` tries all of them (FAILPOINTS=all).
"""

import json
import os

import httpx
import pytest

from app.maintenance.doctor import Severity, examine
from app.maintenance.gc import collect
from app.settings import Settings
from app.storage.base import sha256_of
from tests.support import frames as scene
from tests.support.api import BASE
from tests.support.archives import TAR, frame, tar_archive
from tests.support.crash_points import (
    Point,
    client_of,
    crashing_servers,
    running_client,
)
from tests.support.data_folders import blobs, silently
from tests.support.pictures import painted, png

pytestmark = [
    pytest.mark.long,
    pytest.mark.sqlite_files("its process is killed within its commits"),
]

POINTS_BEFORE_STORING = [
    Point("draft", after=True),
    Point("draft", after=True, turn=2),
    Point("flush_file", after=False),
    Point("flush_file", after=True, turn=2),
    Point("rename", after=False),
    Point("rename", after=True),
    Point("rename", after=True, turn=2),
    Point("flush_folder", after=False),
    Point("flush_folder", after=True),
    Point("flush_folder", after=True, turn=2),
    Point("commit", after=False),
]
POINTS_AFTER_STORING = [
    Point("commit", after=True),
    Point("answer", after=False),
    Point("answer", after=True),
]
ALL_POINTS = [*POINTS_BEFORE_STORING, *POINTS_AFTER_STORING]
TESTS_ALL_POINTS = os.environ.get("FAILPOINTS") == "all"
CHOSEN_POINTS = {
    "upload": ("after-rename-1", "before-commit-1", "after-commit-1"),
    "batch": ("after-flush_folder-1", "after-answer-1"),
    "review": ("after-commit-1",),
}


@pytest.fixture(scope="module")
def servers(tmp_path_factory):
    with crashing_servers(tmp_path_factory.mktemp("crashing") / "data") as program:
        yield program


@pytest.fixture(scope="module")
def dataset(servers):
    with running_client(servers) as api:
        return api.dataset()


def killed(servers, point, act):
    """Send a request to a server that is killed at this point of its work.

    `act` gets a client and returns the function that sends the request. Returns what
    that function returns: what the server has acknowledged.
    """
    with client_of(servers.server(point)) as api:
        prepared = act(api)
        servers.arm()
        acknowledged = prepared()
    assert servers.wait_for_exit(ask=False) == -9, "the server never came to that point"
    return acknowledged


def image_and_segmentation(number):
    """An image and a segmentation that are different for each number."""
    tags = scene.tags()
    tags[0, number % scene.WIDTH] = tags[-1, 0]
    tags[1, number // scene.WIDTH] = tags[-1, 0]
    return {"image": scene.image(number), "segmentation": png(painted(tags))}


def upload(dataset, number):
    def send(api):
        try:
            response = api.put(
                dataset, f"put/{number}", **image_and_segmentation(number)
            )
        except httpx.TransportError:
            return []
        return [f"put/{number}"] if response.status_code == 201 else []

    return lambda api: lambda: send(api)


def batch(dataset, number):
    """Send a batch of two frames; the keys with status 201 are acknowledged."""
    content = tar_archive(
        frame(f"{number}-a", number=number) + frame(f"{number}-b", number=number + 128)
    )

    def send(api):
        lines = []
        try:
            with api.http.stream(
                "POST",
                f"{BASE}/datasets/{dataset}/batches",
                content=content,
                headers=TAR,
            ) as response:
                lines += response.iter_lines()
        except httpx.TransportError:
            pass
        told = [json.loads(line) for line in lines if line.endswith("}")]
        return [line["key"] for line in told if line.get("status") == 201]

    return lambda api: lambda: send(api)


def stored(api, dataset):
    items = api.json(f"/datasets/{dataset}/frames", limit=1000)["items"]
    return {item["key"]: item["id"] for item in items}


def check_frame_is_complete(api, frame_id):
    """Check that a frame's boxes are decided and that its files match their digests."""
    described = api.json(f"/frames/{frame_id}")
    assert [box["verdict"] for box in described["boxes"]] == ["kept", "rejected"]
    for kind in ("image", "segmentation"):
        response = api.get(f"/frames/{frame_id}/{kind}")
        assert response.status_code == 200
        assert response.headers["etag"] == f'"{sha256_of(response.content)}"'


def check_doctor_finds_nothing(data):
    findings = [
        finding
        for finding in examine(Settings(data=data), verify=True, steps=silently)
        if finding.severity in (Severity.WARNING, Severity.ERROR)
    ]
    assert findings == []


@pytest.mark.parametrize(
    ("act", "point"),
    [
        pytest.param(act, point, id=f"{act.__name__}-{point}")
        for act in (upload, batch)
        for point in ALL_POINTS
        if TESTS_ALL_POINTS or str(point) in CHOSEN_POINTS[act.__name__]
    ],
)
def test_frames_are_complete_or_absent_after_a_kill(servers, dataset, act, point):
    number = 10 + 2 * ALL_POINTS.index(point) + (act is batch)
    keys = (
        {f"put/{number}"} if act is upload else {f"run/{number}-a", f"run/{number}-b"}
    )

    acknowledged = killed(servers, point, act(dataset, number))

    with running_client(servers) as api:
        frames = stored(api, dataset)
        assert {*acknowledged} <= keys & frames.keys()
        assert keys & frames.keys() == (
            keys if point in POINTS_AFTER_STORING else set()
        )
        for key in keys & frames.keys():
            check_frame_is_complete(api, frames[key])
        check_doctor_finds_nothing(servers.data)
        act(dataset, number)(api)()
        frames = stored(api, dataset)
        for key in keys:
            check_frame_is_complete(api, frames[key])


@pytest.mark.parametrize(
    "point",
    [
        point
        for point in ALL_POINTS[-4:]
        if TESTS_ALL_POINTS or str(point) in CHOSEN_POINTS["review"]
    ],
    ids=str,
)
def test_review_is_stored_or_absent_after_a_kill(servers, dataset, point):
    boxes: list[int] = []

    def send(api):
        try:
            return api.review(boxes[0], "reject").status_code
        except httpx.TransportError:
            return None

    def prepare(api):
        number = 100 + ALL_POINTS.index(point)
        frame = api.upload_frame(
            dataset, f"r/{number}", **image_and_segmentation(number)
        )
        boxes.append(frame["decisions"][0]["box_id"])
        return lambda: send(api)

    told = killed(servers, point, prepare)

    with running_client(servers) as api:
        review = api.json(f"/boxes/{boxes[0]}")["review"]
    assert (review is not None) == (point in POINTS_AFTER_STORING)
    assert told in ((None, 201) if point in POINTS_AFTER_STORING else (None,))


def test_garbage_collection_removes_leftovers_of_killed_servers(servers, dataset):
    """It creates leftovers of its own, so it also passes without the other tests."""
    killed(servers, Point("rename", after=True, turn=2), upload(dataset, 200))
    left = len(blobs(servers.data))

    settings = Settings(data=servers.data)
    collect(settings, grace_hours=-1, dry_run=False, steps=silently)

    assert len(blobs(servers.data)) < left
    check_doctor_finds_nothing(servers.data)
