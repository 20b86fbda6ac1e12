"""Answers on one box: stored in full, and refused if the box has changed since."""

from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timezone

import pytest
from sqlalchemy import update

from app.db.tables import Review, Run
from tests.support import frames as scene
from tests.support.api import Api


def test_each_answer_changes_the_effective_verdict_and_stats(api, dataset, ghosts):
    seen = []
    for revision, verdict in enumerate(["keep", "unsure", "reject", "clear"]):
        body = api.review(ghosts[0], verdict, revision).json()
        stats = api.json(f"/datasets/{dataset}/stats")
        figures = [
            *(stats[key] for key in ("reviewed", "unsure", "conflicts")),
            stats["bins"]["wall"],
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


@pytest.mark.parametrize("has_numbers", [True, False], ids=["new runs", "old runs"])
def test_history_is_in_the_order_of_storing_not_of_the_clock(service, has_numbers):
    api = Api(service.admin())
    with api.http:
        name = api.dataset()
        box_id = api.upload_frame(name, "0")["decisions"][0]["box_id"]
        api.review(box_id, "keep")
        first = api.run(name, {"min_visible_pixels": 10**6})["id"]
        for revision, verdict in enumerate(["reject", "unsure"], 1):
            api.review(box_id, verdict, revision)
        second = api.run(name, {})["id"]
        with service.app.state.database.write() as session:
            if has_numbers:
                backwards = datetime(2020, 1, 1, tzinfo=timezone.utc)
                session.execute(
                    update(Review)
                    .where(Review.revision > 1)
                    .values(created_at=backwards)
                )
                session.execute(
                    update(Run).where(Run.id == second).values(finished_at=backwards)
                )
            else:
                session.execute(update(Run).values(last_review_id=None))

        path = f"/boxes/{box_id}/history"
        items = api.json(path)["items"]
        pages = [api.get(path, limit=1)]
        while "next" in pages[-1].links:
            pages.append(api.http.get(pages[-1].links["next"]["url"]))
        wrong = [
            api.get(path, cursor=cursor) for cursor in ("1", "x~1", "inf~1", "-1~1")
        ]

    assert [entry for page in pages for entry in page.json()["items"]] == items
    assert [len(page.json()["items"]) for page in pages] == [1] * len(items)
    assert pages[-1].json()["next_cursor"] is None
    assert {(response.status_code, response.json()["code"]) for response in wrong} == {
        (400, "bad_cursor")
    }
    told = [
        entry["run"] if entry["kind"] == "decision" else entry["verdict"]
        for entry in items
    ]
    assert told[:-1] == [second, "unsure", "reject", first, "keep"]


def test_the_history_of_a_box_shows_the_match_of_the_box(api):
    """It is at most 100 %, and empty for a box whose pixels are all masked."""
    mask = {"polygons": [[[0, 0], [16, 0], [16, 16], [0, 16]]]}
    name = api.dataset(ignore_mask=mask)
    boxes = [
        {"id": "on the car", "class": "car", "xyxy": [20.9, 24.9, 39.1, 39.1]},
        {"id": "masked", "class": "car", "xyxy": scene.IN_THE_SKY},
    ]
    api.upload_frame(name, "0", {**scene.annotation(), "boxes": boxes})
    api.run(name, {"profile": "carlasimu"})

    shown = {box["id"]: box for box in api.boxes(name)}
    told = {
        key: api.json(f"/boxes/{box['box_id']}/history")["items"][0]
        for key, box in shown.items()
    }

    assert shown["on the car"]["match_percent"] == 100
    assert shown["masked"]["match_percent"] is None
    for key in ("verdict", "reason", "match_percent", "threshold"):
        assert {box: told[box][key] for box in told} == {
            box: shown[box][key] for box in shown
        }


def test_answer_that_changes_nothing_is_not_stored(api, ghosts):
    comment = {"comment": "half hidden"}
    first = api.review(ghosts[0], "keep", **comment)

    again = api.review(ghosts[0], "keep", 1, **comment)
    stale = api.review(ghosts[0], "keep", **comment)
    commented = api.review(ghosts[0], "keep", 1, comment="half hidden!")

    assert (again.status_code, again.json()) == (200, first.json())
    assert stale.status_code == 412
    assert (commented.status_code, commented.json()["revision"]) == (201, 2)
    history = api.json(f"/boxes/{ghosts[0]}/history")["items"]
    assert [entry.get("revision") for entry in history] == [2, 1, None]


def test_same_answer_of_another_person_or_after_an_undo_is_stored(service, as_role):
    with service.admin() as http:
        api, other = Api(http), Api(as_role("reviewer"))
        box_id = api.upload_frame(api.dataset(), "0")["decisions"][0]["box_id"]
        api.review(box_id, "keep")
        others = other.review(box_id, "keep", 1)
        api.review(box_id, "reject", 2)
        other.review(box_id, "keep", 3)
        api.review(box_id, "keep", 4)
        api.post(f"/boxes/{box_id}/reviews/5/undo")
        after_undo = api.review(box_id, "keep", 6)

    assert (others.status_code, others.json()["revision"]) == (201, 2)
    assert (after_undo.status_code, after_undo.json()["revision"]) == (201, 7)


def test_one_person_answers_a_box_only_so_often(service, as_role):
    """All doors are shut then; others can still answer, and undo."""
    with service.admin() as http:
        api = Api(http)
        name = api.dataset()
        box_id = api.upload_frame(name, "0")["decisions"][0]["box_id"]
        own = Api(as_role("reviewer"))
        most = service.app.state.settings.max_answers_per_box
        for seen in range(most):
            response = own.review(box_id, ("keep", "reject")[seen % 2], seen)
            assert response.status_code == 201, response.text
        last = own.json(f"/boxes/{box_id}")["revision"]
        bulk = {"dataset": name, "verdict": "unsure", "box_ids": [box_id]}
        chosen = {"dataset": name, "verdict": "unsure", "filter": {"review": "any"}}
        listed = own.json("/boxes", dataset=name, review="any", count="true")

        refused = [
            own.review(box_id, "unsure", last),
            own.post(f"/boxes/{box_id}/reviews/{last}/undo"),
            own.post("/reviews/bulk", {**bulk, "seen_revisions": [last]}),
            own.post("/reviews/bulk", {**chosen, "snapshot": listed["snapshot"]}),
        ]
        undone = api.post(f"/boxes/{box_id}/reviews/{last}/undo")

    assert {
        (response.status_code, response.json()["code"]) for response in refused
    } == {(409, "too_many_answers")}
    for response in refused:
        detail = response.json()["detail"]
        assert f"box {box_id}" in detail
        assert f"{most} answers" in detail
        assert "UNGHOST_MAX_ANSWERS_PER_BOX" in detail
    assert (undone.status_code, undone.json()["revision"]) == (201, most + 1)


def test_undo_of_a_bulk_answer_counts_as_an_answer(service, as_role):
    with service.admin() as http:
        api = Api(http)
        name = api.dataset()
        box_id = api.upload_frame(name, "0")["decisions"][0]["box_id"]
        own = Api(as_role("reviewer"))
        body = {"dataset": name, "verdict": "keep", "box_ids": [box_id]}
        batch = own.post("/reviews/bulk", body).json()["id"]
        undo = own.post(f"/review-batches/{batch}/undo").json()["id"]
        most = service.app.state.settings.max_answers_per_box
        for _ in range(most - 2):
            undone = own.post(f"/review-batches/{undo}/undo")
            assert undone.status_code == 200, undone.text
            undo = undone.json()["id"]

        refused = own.post(f"/review-batches/{undo}/undo")

    assert (refused.status_code, refused.json()["code"]) == (409, "too_many_answers")


def test_stale_answer_returns_412_with_the_current_box(api, ghosts):
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


def test_concurrent_answers_on_one_box_store_one_others_get_412(api, ghosts):
    with ThreadPoolExecutor(8) as pool:
        responses = list(pool.map(lambda _: api.review(ghosts[0], "keep"), range(8)))

    assert sorted(response.status_code for response in responses) == [201] + [412] * 7
    assert api.json(f"/boxes/{ghosts[0]}")["revision"] == 1


NOT_ACCEPTED: tuple[dict[str, object], ...] = (
    {},
    {"verdict": "keep"},
    {"verdict": "kept", "seen_revision": 0},
    {"verdict": "keep", "seen_revision": -1},
    {"verdict": "keep", "seen_revision": 10**20},
    {"verdict": "keep", "seen_revision": 0, "comment": "x" * 2001},
    {"verdict": "keep", "seen_revision": 0, "comment": "\0"},
    {"verdict": "keep", "seen_revision": 0, "reviewer": "eve"},
)


def test_invalid_answer_is_refused_and_changes_nothing(api, ghosts):
    for body in NOT_ACCEPTED:
        response = api.post(f"/boxes/{ghosts[0]}/reviews", body)
        refusal = (response.status_code, response.json()["code"])
        assert refusal == (422, "invalid_request"), body
    assert api.json(f"/boxes/{ghosts[0]}")["revision"] == 0


FILTERED: tuple[tuple[dict[str, object], list[str]], ...] = (
    ({"effective": "kept"}, ["real", "ghost", "real"]),
    ({"review": "unsure"}, ["ghost"]),
    ({"review": "undecided"}, ["real", "real", "ghost", "ghost"]),
    ({"review": "keep", "verdict": "kept"}, []),
    ({"match_min": 50, "sort": "-match_percent"}, ["real", "real", "real"]),
)


def test_boxes_are_filtered_by_their_answers(api):
    name = api.dataset()
    boxes = [
        box
        for number in range(3)
        for box in api.upload_frame(name, str(number))["decisions"]
    ]
    api.review(boxes[1]["box_id"], "keep")
    api.review(boxes[2]["box_id"], "reject")
    api.review(boxes[3]["box_id"], "unsure")

    for filters, ids in FILTERED:
        listed = [box["id"] for box in api.boxes(name, **filters)]
        assert sorted(listed) == sorted(ids), filters
