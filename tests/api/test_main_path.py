"""The main path, from frames to labels, over HTTP and on the database under test."""

import io
import json
import zipfile

import pytest

from tests.support import frames as scene
from tests.support.api import BASE
from tests.support.archives import batch_results, frame, send, tar_archive

FRAMES = 24
NOTHING_VISIBLE = {"min_visible_pixels": 10**6}
CARS_ARE_SKY = {"classes": {"car": {"accept": ["Sky"]}}}


@pytest.fixture
def street(api):
    """A dataset whose frames came in one batch, each with a car and a ghost."""
    name = api.dataset()
    members = [
        member
        for number in range(FRAMES)
        for member in frame(f"{number:02}", number=number)
    ]
    results, end = batch_results(send(api, name, tar_archive(members)))
    assert [status for _, status in results] == [201] * FRAMES, results
    assert end["stored"] == FRAMES
    return name


def stats(api, name):
    counts = api.json(f"/datasets/{name}/stats")
    return counts["frames"], counts["kept"], counts["rejected"]


def take_from_queue(api, name, limit):
    response = api.post(
        f"/datasets/{name}/queue", {"limit": limit, "filters": {"review": "undecided"}}
    )
    assert response.status_code == 200, response.text
    return response.json()


def test_main_path_of_upload_review_undo_run_and_export(api, street):
    pushed = stats(api, street)
    queue = take_from_queue(api, street, 5)
    for box in queue["items"]:
        assert api.review(box["box_id"], "reject").status_code == 201
    stale = api.review(queue["items"][0]["box_id"], "keep")
    left = take_from_queue(api, street, 5)["remaining"]
    ghosts = api.boxes(street, verdict="rejected", review="none", limit=1000)
    ids = [box["box_id"] for box in ghosts]
    body = {"dataset": street, "box_ids": ids, "verdict": "keep"}
    bulk = api.post("/reviews/bulk", body).json()
    undone = api.post(f"/review-batches/{bulk['id']}/undo").json()
    hidden = api.run(street, NOTHING_VISIBLE)
    none_kept = stats(api, street)
    recounted = api.run(street, CARS_ARE_SKY)
    measured = api.run(street, {"profile": "carlasimu"})
    diff = api.json(f"/runs/{hidden['id']}/diff")

    assert pushed == (FRAMES, FRAMES, FRAMES)
    assert (stale.status_code, left) == (412, 2 * FRAMES - 5)
    assert (bulk["count"], undone["undone"]) == (len(ghosts), len(ghosts))
    assert (hidden["changed"], none_kept) == (FRAMES, (FRAMES, 0, 2 * FRAMES))
    assert (recounted["state"], measured["state"]) == ("done", "done")
    assert diff["total"] == FRAMES
    assert len(labels_of(api, street)) == FRAMES


def labels_of(api, name):
    """The label files of an export, checked against the counts of its manifest.json."""
    accepted = api.post(f"/datasets/{name}/exports", {"format": "yolo", "options": {}})
    export = api.wait_for_job(accepted)
    assert export["state"] == "done", export
    content = api.http.get(export["download"]).content
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        manifest = json.loads(archive.read("manifest.json"))
        names = [each for each in archive.namelist() if each.startswith("labels/")]
    assert manifest["dataset"] == name
    return names


def test_stats_are_right_after_replaced_repeated_and_deleted_frames(api, street):
    other = {**scene.annotation(), "number": 99}
    first = api.put(street, "run/00", other)
    replaced = api.put(street, "run/00", other, replace=True)
    repeated = api.put(street, "run/00", other)
    deleted = api.http.delete(f"{BASE}/datasets/{street}/frames/run/01")

    codes = [each.status_code for each in (first, replaced, repeated, deleted)]
    assert codes == [409, 201, 200, 204]
    assert stats(api, street) == (FRAMES - 1,) * 3
    boxes = api.json("/boxes", dataset=street, limit=1000)["items"]
    assert len(boxes) == 2 * (FRAMES - 1)


def test_box_list_pagination_in_every_sort_order(api, street):
    for order in ("id", "doubt", "match_percent", "-match_percent", "crowding"):
        seen: list[int] = []
        cursor: dict[str, str] | None = {}
        while cursor is not None:
            page = api.json("/boxes", dataset=street, sort=order, limit=7, **cursor)
            seen += [box["box_id"] for box in page["items"]]
            cursor = page["next_cursor"] and {"cursor": page["next_cursor"]}
        assert len(seen) == len(set(seen)) == 2 * FRAMES, order


def test_review_with_a_repeated_idempotency_key_is_replayed(api, street):
    box = api.boxes(street)[0]["box_id"]
    body = {"verdict": "keep", "seen_revision": 0}
    headers = {"Idempotency-Key": f"main-path-{box}"}

    first, again = (
        api.http.post(f"{BASE}/boxes/{box}/reviews", json=body, headers=headers)
        for _ in range(2)
    )

    assert (first.status_code, again.status_code) == (201, 201)
    assert again.content == first.content
    assert again.headers["Idempotent-Replayed"] == "true"
