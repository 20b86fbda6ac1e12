"""Histories, problems and the end of a cut batch have every field of their model."""

from __future__ import annotations

import json
from collections.abc import Iterator

import httpx
import pytest

from tests.support import archives, plain_http
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
def uploaded_dataset(http: httpx.Client, dataset: str) -> str:
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


def test_history_entries_have_the_keys_of_their_kind(http, client, uploaded_dataset):
    box = box_ids(http, uploaded_dataset)[0]
    successful_json(
        http.post(f"/boxes/{box}/reviews", json={"verdict": "clear", **UNSEEN})
    )
    client.wait(
        client.start_run(
            uploaded_dataset, {"min_visible_pixels": 100_000}, activate=True
        )
    )

    raw = successful_json(http.get(f"/boxes/{box}/history"))

    assert_matches_model(wire.History, raw)
    decided = {"kind", "at", "verdict", "run", "config", "reason"} | {
        "match_percent",
        "threshold",
    }
    answered = {"kind", "at", "verdict", "revision", "reviewer", "comment"} | {
        "batch",
        "batch_size",
        "looked_at",
        "undoes",
        "carried_from",
        "imported_by",
        "looked_ms",
        "chosen_by",
        "chosen_from",
        "probability",
    }
    assert [set(entry) for entry in raw["items"]] == [
        decided | {"activated"},
        answered,
        decided,
    ]
    assert {*decided, *answered, "activated"} == {*wire.HistoryEntry.model_fields}


def test_last_line_for_a_truncated_archive_has_every_field(http, dataset):
    whole = archives.tar_archive([*archives.frame("a"), *archives.frame("b")])
    told = http.post(
        f"/datasets/{dataset}/batches",
        content=whole[: len(whole) // 2],
        headers={"Content-Type": "application/x-tar"},
    )
    end = json.loads(told.text.splitlines()[-1])

    assert end["problem"]["status"] == 422
    assert_matches_model(wire.BatchEnd, end)


def test_problem_response_has_every_field_and_its_extra_key(http, uploaded_dataset):
    box = box_ids(http, uploaded_dataset)[0]
    stale = {"verdict": "keep", "seen_revision": 3}
    many = {
        "dataset": uploaded_dataset,
        "box_ids": [box],
        "verdict": "keep",
        "expected_count": 9,
    }
    every = set(wire.Problem.model_json_schema(mode="serialization")["required"])

    refused = {
        "none": http.get("/datasets/none"),
        "current": http.post(f"/boxes/{box}/reviews", json=stale),
        "found": http.post("/reviews/bulk", json=many),
    }

    for key, answer in refused.items():
        assert answer.json().keys() == every | {key} - {"none"}
        assert_matches_model(wire.Problem, answer.json())
