"""Answers on datasets, frames and boxes have every field, and the client reads each."""

from __future__ import annotations

import json
from collections.abc import Iterator

import httpx
import pytest

from tests.support import archives, frames, plain_http
from tests.support.response_checks import assert_matches_model, successful_json
from tests.support.servers import RunningServer
from unghost import wire

BASE = "/api/v1"
UNSEEN = {"seen_revision": 0}


@pytest.fixture
def http(server: RunningServer) -> Iterator[httpx.Client]:
    with plain_http.Client(
        base_url=server.url + BASE, headers=server.headers, timeout=60
    ) as client:
        yield client


@pytest.fixture
def queued(http: httpx.Client, dataset: str) -> str:
    """A dataset with a frame with optional fields, a plain one, and a refused one."""
    seen = {"captured_at": "2026-01-01t00:00:00.5z", "weather": {"cloudiness": 10}}
    archive = [
        *archives.frame("a", number=0, **seen),
        *archives.frame("b", number=1),
        *archives.frame("c", boxes=[{"id": 1}]),
    ]
    told = http.post(
        f"/datasets/{dataset}/batches",
        content=archives.tar_archive(archive),
        headers={"Content-Type": "application/x-tar"},
    )
    assert told.is_success, told.text
    return dataset


def box_ids(http: httpx.Client, dataset: str) -> list[int]:
    listed = successful_json(
        http.get("/boxes", params={"dataset": dataset, "sort": "id"})
    )
    return [box["box_id"] for box in listed["items"]]


def test_each_kind_of_entry_of_a_history_has_its_keys(http, client, queued):
    box = box_ids(http, queued)[0]
    successful_json(
        http.post(f"/boxes/{box}/reviews", json={"verdict": "clear", **UNSEEN})
    )
    client.wait(
        client.start_run(queued, {"min_visible_pixels": 100_000}, activate=True)
    )

    raw = successful_json(http.get(f"/boxes/{box}/history"))

    assert_matches_model(wire.History, raw)
    decided = {"kind", "at", "verdict", "run", "config", "reason"} | {
        "match_percent",
        "threshold",
    }
    answered = {"kind", "at", "verdict", "revision", "reviewer", "comment"} | {
        "batch",
        "carried_from",
    }
    assert [set(entry) for entry in raw["items"]] == [
        decided | {"activated"},
        answered,
        decided,
    ]
    assert {*decided, *answered, "activated"} == {*wire.HistoryEntry.model_fields}


@pytest.mark.parametrize("created", [True, False])
def test_an_upload_is_answered_in_full(http, dataset, created):
    form = {
        "annotation": ("a.json", frames.as_json(frames.annotation())),
        "image": ("a.png", frames.image()),
        "segmentation": ("b.png", frames.segmentation()),
    }
    place = f"/datasets/{dataset}/frames/a"
    answers = [http.put(place, files=form) for _ in range(1 if created else 2)]

    assert answers[-1].status_code == (201 if created else 200)
    stored = successful_json(answers[-1])
    assert_matches_model(wire.StoredFrame, stored)
    assert wire.StoredFrame.answered(stored, created=created).created is created


def test_lines_of_a_batch_are_answered_in_full(http, dataset):
    told = http.post(
        f"/datasets/{dataset}/batches",
        content=archives.tar_archive(
            [*archives.frame("a"), *archives.frame("c", boxes=[{"id": 1}])]
        ),
        headers={"Content-Type": "application/x-tar"},
    )
    stored, refused, end = map(json.loads, told.text.splitlines())

    every = {"key", "status", "frame_id", "decisions"}
    assert (stored.keys(), refused.keys()) == (every, every | {"problem"})
    assert end == {"end": True, "frames": 2, "stored": 1, "same": 0, "refused": 1}
    assert_matches_model(wire.BatchLine, stored)
    assert_matches_model(wire.BatchLine, refused)
    assert_matches_model(wire.BatchEnd, end)
    assert (refused["status"], refused["problem"]["status"]) == (422, 422)


def test_the_last_line_of_an_archive_that_ends_too_early_is_answered_in_full(
    http, dataset
):
    whole = archives.tar_archive([*archives.frame("a"), *archives.frame("b")])
    told = http.post(
        f"/datasets/{dataset}/batches",
        content=whole[: len(whole) // 2],
        headers={"Content-Type": "application/x-tar"},
    )
    end = json.loads(told.text.splitlines()[-1])

    assert end["problem"]["status"] == 422
    assert_matches_model(wire.BatchEnd, end)


def test_a_refusal_has_every_field_of_an_answer_and_what_it_has_to_say(http, queued):
    box = box_ids(http, queued)[0]
    stale = {"verdict": "keep", "seen_revision": 3}
    many = {"dataset": queued, "box_ids": [box], "verdict": "keep", "expected_count": 9}
    every = set(wire.Problem.model_json_schema(mode="serialization")["required"])

    refused = {
        "none": http.get("/datasets/none"),
        "current": http.post(f"/boxes/{box}/reviews", json=stale),
        "found": http.post("/reviews/bulk", json=many),
    }

    for key, answer in refused.items():
        assert answer.json().keys() == every | {key} - {"none"}
        assert_matches_model(wire.Problem, answer.json())


def test_after_an_answer_was_undone_its_revision_goes_on(client, filled):
    box = next(client.boxes(filled))
    client.review(box.box_id, "keep", seen_revision=box.revision)
    client.review(box.box_id, "clear", seen_revision=1)

    cleared = client.box(box.box_id)

    assert (cleared.review, cleared.revision) == (None, 2)
    assert client.review(box.box_id, "reject", seen_revision=2).revision == 3
