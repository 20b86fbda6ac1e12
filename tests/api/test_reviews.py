"""Answers of people: one, many, taken back, and never lost."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.api import frames as scene
from tests.api.resources import BASE


@pytest.fixture
def dataset(api):
    """Three frames, each with a car and a ghost."""
    name = api.dataset()
    for number in range(3):
        api.stored(name, str(number), {**scene.annotation(), "number": number})
    return name


@pytest.fixture
def ghosts(api, dataset):
    return [box["box_id"] for box in api.boxes(dataset, verdict="rejected")]


def bulk(api, dataset, verdict, **which):
    body = {"dataset": dataset, "verdict": verdict, **which}
    return api.post("/reviews/bulk", body)


def undo(api, batch):
    return api.post(f"/review-batches/{batch}/undo")


def effective(api, dataset):
    return api.json(f"/datasets/{dataset}/stats")["effective"]["kept"]


def test_an_answer_is_stored_whole(api, ghosts):
    answer = api.review(ghosts[0], "keep", comment="there is one")

    body = answer.json()
    assert answer.status_code == 201
    assert {key: body[key] for key in body if key != "created_at"} == {
        "box_id": ghosts[0],
        "revision": 1,
        "verdict": "keep",
        "reviewer": "admin",
        "comment": "there is one",
        "effective_verdict": "kept",
    }
    box = api.json(f"/boxes/{ghosts[0]}")
    assert (box["verdict"], box["effective_verdict"], box["revision"]) == (
        "rejected",
        "kept",
        1,
    )


def test_each_answer_decides_what_counts(api, dataset, ghosts):
    seen = []
    for revision, verdict in enumerate(["keep", "unsure", "reject", "clear"]):
        body = api.review(ghosts[0], verdict, revision).json()
        stats = api.json(f"/datasets/{dataset}/stats")
        figures = [
            stats[key] for key in ("reviewed", "unsure", "conflicts", "to_review")
        ]
        seen.append((verdict, body["effective_verdict"], figures))

    assert seen == [
        ("keep", "kept", [1, 0, 1, 2]),
        ("unsure", "rejected", [0, 1, 0, 3]),
        ("reject", "rejected", [1, 0, 0, 2]),
        ("clear", "rejected", [0, 0, 0, 3]),
    ]
    box = api.json(f"/boxes/{ghosts[0]}")
    assert (box["review"], box["revision"]) == (None, 4)
    history = api.json(f"/boxes/{ghosts[0]}/history")["items"]
    assert [entry["verdict"] for entry in history] == [
        "clear",
        "reject",
        "unsure",
        "keep",
        "rejected",
    ]


def test_a_stale_answer_is_412_with_what_there_is_now(api, ghosts):
    api.review(ghosts[0], "keep", comment="first")

    stale = api.review(ghosts[0], "reject", 0)
    early = api.review(ghosts[0], "reject", 7)

    assert (stale.status_code, early.status_code) == (412, 412)
    problem = stale.json()
    assert (problem["code"], problem["current"]) == (
        "stale_review",
        {
            key: value
            for key, value in api.json(f"/boxes/{ghosts[0]}").items()
            if key != "neighbours"
        },
    )
    assert problem["current"]["review"]["comment"] == "first"


def test_of_many_reviewers_at_once_one_is_first(api, ghosts):
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: api.review(ghosts[0], "keep"), range(8)))

    assert sorted(answer.status_code for answer in answers) == [201] + [412] * 7
    assert api.json(f"/boxes/{ghosts[0]}")["revision"] == 1


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"verdict": "keep"},
        {"verdict": "kept", "seen_revision": 0},
        {"verdict": "keep", "seen_revision": -1},
        {"verdict": "keep", "seen_revision": 10**20},
        {"verdict": "keep", "seen_revision": 0, "comment": "x" * 2001},
        {"verdict": "keep", "seen_revision": 0, "comment": "\0"},
        {"verdict": "keep", "seen_revision": 0, "reviewer": "eve"},
    ],
)
def test_a_bad_answer_is_refused_and_changes_nothing(api, ghosts, body):
    answer = api.post(f"/boxes/{ghosts[0]}/reviews", body)

    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")
    assert api.json(f"/boxes/{ghosts[0]}")["revision"] == 0


def test_half_a_character_is_no_comment(api, ghosts):
    body = rb'{"verdict": "keep", "seen_revision": 0, "comment": "\ud800"}'
    headers = {"Content-Type": "application/json"}

    answer = api.http.post(
        f"{BASE}/boxes/{ghosts[0]}/reviews", content=body, headers=headers
    )

    assert answer.status_code == 422


def test_many_boxes_are_one_act_and_one_undo(api, dataset, ghosts):
    api.review(ghosts[0], "unsure", comment="before")
    elsewhere = api.stored(api.dataset(), "a")["decisions"][0]["box_id"]
    ids = [*ghosts, elsewhere, ghosts[0], 2**62]

    answer = bulk(api, dataset, "keep", box_ids=ids, comment="all of them")
    batch = answer.json()
    kept = effective(api, dataset)
    undone = undo(api, batch["id"]).json()

    assert answer.status_code == 201
    assert answer.headers["location"] == f"{BASE}/review-batches/{batch['id']}"
    assert batch == {
        "id": batch["id"],
        "dataset": dataset,
        "verdict": "keep",
        "count": 3,
        "skipped": [elsewhere, 2**62],
    }
    assert kept == 6
    assert undone == {"id": undone["id"], "undone": 3, "skipped": []}
    review = api.json(f"/boxes/{ghosts[0]}")["review"]
    assert (review["verdict"], review["comment"]) == ("unsure", "before")
    assert api.json(f"/boxes/{ghosts[1]}")["review"] is None
    assert api.json(f"/boxes/{elsewhere}")["revision"] == 0
    assert effective(api, dataset) == 3
    again = undo(api, batch["id"])
    assert (again.status_code, again.json()["code"]) == (409, "already_undone")


def test_an_undo_leaves_what_somebody_said_since(api, dataset, ghosts):
    batch = bulk(api, dataset, "keep", box_ids=ghosts).json()["id"]
    api.review(ghosts[1], "reject", 1)
    api.put(dataset, "2", {**scene.annotation(), "boxes": []}, replace=True)

    undone = undo(api, batch).json()

    assert undone == {"id": undone["id"], "undone": 1, "skipped": ghosts[1:]}
    assert api.json(f"/boxes/{ghosts[1]}")["review"]["verdict"] == "reject"


def test_an_undo_can_be_undone(api, dataset, ghosts):
    batch = bulk(api, dataset, "keep", box_ids=ghosts).json()["id"]
    first = undo(api, batch).json()

    second = undo(api, first["id"])

    assert second.json()["undone"] == 3
    assert effective(api, dataset) == 6


def test_stacked_acts_are_undone_one_after_the_other(api, dataset, ghosts):
    api.review(ghosts[0], "unsure", comment="before")
    first = bulk(api, dataset, "keep", box_ids=ghosts).json()["id"]
    second = bulk(api, dataset, "reject", box_ids=ghosts[:2]).json()["id"]
    third = bulk(api, dataset, "unsure", box_ids=ghosts[:1]).json()["id"]

    undone = [undo(api, batch).json() for batch in (third, second, first)]

    assert [(one["undone"], one["skipped"]) for one in undone] == [
        (1, []),
        (2, []),
        (3, []),
    ]
    review = api.json(f"/boxes/{ghosts[0]}")["review"]
    assert (review["verdict"], review["comment"]) == ("unsure", "before")
    assert [api.json(f"/boxes/{box}")["review"] for box in ghosts[1:]] == [None, None]
    assert effective(api, dataset) == 3


def test_an_act_under_one_that_stands_is_left(api, dataset, ghosts):
    first = bulk(api, dataset, "keep", box_ids=ghosts).json()["id"]
    second = bulk(api, dataset, "reject", box_ids=ghosts[:2]).json()["id"]
    redone = undo(api, undo(api, second).json()["id"])

    undone = undo(api, first).json()

    assert redone.json()["undone"] == 2
    assert (undone["undone"], undone["skipped"]) == (1, ghosts[:2])


def test_an_answer_between_acts_still_stands_when_both_are_undone(api, dataset, ghosts):
    first = bulk(api, dataset, "keep", box_ids=ghosts).json()["id"]
    api.review(ghosts[0], "unsure", 1)
    second = bulk(api, dataset, "reject", box_ids=ghosts).json()["id"]
    undo(api, second)

    undone = undo(api, first).json()

    assert (undone["undone"], undone["skipped"]) == (2, ghosts[:1])
    assert api.json(f"/boxes/{ghosts[0]}")["review"]["verdict"] == "unsure"


def test_a_filter_is_answered_if_it_has_as_many_boxes_as_were_seen(api, dataset):
    rejected = {"filter": {"verdict": "rejected", "class": "car"}}

    blind = bulk(api, dataset, "keep", **rejected)
    wrong = bulk(api, dataset, "keep", **rejected, expected_count=4)
    right = bulk(api, dataset, "keep", **rejected, expected_count=3)

    assert [each.status_code for each in (blind, wrong, right)] == [422, 409, 201]
    assert wrong.json()["code"] == "count_changed"
    assert "3" in wrong.json()["detail"]
    assert wrong.json()["found"] == 3
    assert right.json()["count"] == 3
    assert effective(api, dataset) == 6


@pytest.mark.parametrize(
    ("which", "status"),
    [
        ({}, 422),
        ({"box_ids": [1], "filter": {}}, 422),
        ({"box_ids": [0]}, 422),
        ({"box_ids": ["x"]}, 422),
        ({"box_ids": [1, 2], "expected_count": 1}, 409),
        ({"filter": {"colour": "blue"}, "expected_count": 0}, 422),
        ({"filter": {"reason": "magic"}, "expected_count": 0}, 400),
    ],
)
def test_a_bad_bulk_review_is_refused(api, dataset, which, status):
    answer = bulk(api, dataset, "keep", **which)

    assert answer.status_code == status
    assert api.json(f"/datasets/{dataset}/stats")["reviewed"] == 0


def test_a_bulk_review_without_boxes_changes_nothing(api, dataset):
    answer = bulk(api, dataset, "keep", box_ids=[])

    assert (answer.status_code, answer.json()["count"]) == (201, 0)
    assert undo(api, answer.json()["id"]).json()["undone"] == 0
    assert undo(api, 2**40).status_code == 404


@pytest.mark.parametrize(
    ("filters", "ids"),
    [
        ({"effective": "kept"}, ["real", "ghost", "real"]),
        ({"effective": "rejected"}, ["real", "ghost", "ghost"]),
        ({"review": "decided"}, ["ghost", "real"]),
        ({"review": "unsure"}, ["ghost"]),
        ({"review": "undecided"}, ["real", "real", "ghost", "ghost"]),
        ({"review": "keep", "verdict": "kept"}, []),
        ({"match_min": 50, "sort": "-match_percent"}, ["real", "real", "real"]),
    ],
)
def test_boxes_are_listed_by_what_people_said(api, filters, ids):
    name = api.dataset()
    boxes = [
        box for number in range(3) for box in api.stored(name, str(number))["decisions"]
    ]
    api.review(boxes[1]["box_id"], "keep")
    api.review(boxes[2]["box_id"], "reject")
    api.review(boxes[3]["box_id"], "unsure")

    found = [box["id"] for box in api.boxes(name, **filters)]

    assert sorted(found) == sorted(ids)


@pytest.mark.parametrize(
    "cursor",
    [
        "x",
        "ü",
        "bnVsbA",
        "WzEsMiwzXQ",
        "WzAsSW5maW5pdHksMCwwXQ",
        "W0luZmluaXR5LDAsMCwwXQ",
        "WzAsMCwwLDFlMzBd",
        "WzAsMCwxMDAwMDAwMDAwMDAwMDAwMDAwMDAwMCwwXQ",
        "WzAsTmFOLDAsMF0",
        "W1tbW1tb" * 200,
    ],
)
@pytest.mark.parametrize("sort", ["id", "doubt"])
def test_a_cursor_that_is_not_ours_is_400(api, dataset, cursor, sort):
    answer = api.get("/boxes", dataset=dataset, cursor=cursor, sort=sort)

    assert (answer.status_code, answer.json()["code"]) == (400, "bad_request")
