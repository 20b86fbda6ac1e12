"""Bulk answers: given only on boxes as they were seen, and undone together."""

import base64
import json
from itertools import product

import pytest
from sqlalchemy import insert

from app.db.tables import Review
from tests.support import frames as scene
from tests.support.api import BASE, Api

NO_BOXES = "WyJ4IiwwLDAsMCwwXQ"
"""A snapshot of a filter that does not exist."""


def bulk(api, dataset, verdict, **which):
    body = {"dataset": dataset, "verdict": verdict, **which}
    return api.post("/reviews/bulk", body)


def snapshot(api, dataset, **filters):
    page = api.json("/boxes", dataset=dataset, count="true", **filters)
    return page["snapshot"]


def undo(api, batch):
    return api.post(f"/review-batches/{batch}/undo")


def effective(api, dataset):
    return api.json(f"/datasets/{dataset}/stats")["effective"]["kept"]


def test_bulk_answer_is_undone_completely_and_only_once(api, dataset, ghosts):
    api.review(ghosts[0], "unsure", comment="before")
    elsewhere = api.upload_frame(api.dataset(), "a")["decisions"][0]["box_id"]
    ids = [*ghosts, elsewhere, ghosts[0], 2**62]

    seen = [1, 0, 0, 0, 1, 0]
    response = bulk(
        api, dataset, "keep", box_ids=ids, seen_revisions=seen, comment="all of them"
    )
    batch = response.json()
    kept = effective(api, dataset)
    undone = undo(api, batch["id"]).json()

    assert response.status_code == 201
    assert response.headers["location"] == f"{BASE}/review-batches/{batch['id']}"
    assert batch == {
        "id": batch["id"],
        "dataset": dataset,
        "verdict": "keep",
        "count": 3,
        "skipped": [elsewhere, 2**62],
        "stale": [],
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


@pytest.mark.parametrize("by_filter", [False, True], ids=["listed", "by filter"])
def test_bulk_answer_repeated_without_change_adds_nothing(
    api, dataset, ghosts, by_filter
):
    def answer(verdict, comment):
        if not by_filter:
            seen = [api.json(f"/boxes/{box}")["revision"] for box in ghosts]
            which = {"box_ids": ghosts, "seen_revisions": seen}
        else:
            which = {"filter": {"verdict": "rejected"}}
            which["snapshot"] = snapshot(api, dataset, verdict="rejected")
        return bulk(api, dataset, verdict, comment=comment, **which)

    def entries():
        return [len(api.json(f"/boxes/{box}/history")["items"]) for box in ghosts] + [
            len(api.json("/audit", limit=1000)["items"])
        ]

    api.review(ghosts[0], "keep", comment="parked")
    first = answer("keep", "parked")
    before = entries()
    again = answer("keep", "parked")

    assert (first.status_code, first.json()["count"]) == (201, 3)
    assert (again.status_code, again.json()["count"]) == (201, 0)
    assert (again.json()["stale"], again.json()["skipped"]) == ([], [])
    assert entries() == before
    assert undo(api, again.json()["id"]).json()["undone"] == 0
    assert answer("keep", "parked?").json()["count"] == 3
    assert answer("reject", "parked?").json()["count"] == 3
    undo(api, answer("keep", "parked?").json()["id"])
    assert answer("reject", "parked?").json()["count"] == 3  # an undo is no answer


def test_undo_skips_boxes_answered_or_replaced_since_and_can_be_undone(
    api, dataset, ghosts
):
    batch = bulk(api, dataset, "keep", box_ids=ghosts).json()["id"]
    first = undo(api, batch).json()
    second = undo(api, first["id"]).json()
    assert (second["undone"], effective(api, dataset)) == (3, 6)

    api.review(ghosts[1], "reject", 3)
    api.put(dataset, "2", {**scene.annotation(), "boxes": []}, replace=True)

    undone = undo(api, second["id"]).json()
    assert undone == {"id": undone["id"], "undone": 1, "skipped": ghosts[1:]}
    assert api.json(f"/boxes/{ghosts[1]}")["review"]["verdict"] == "reject"


def test_bulk_answer_on_a_filter_needs_its_snapshot_and_count(api, dataset):
    filters = {"verdict": "rejected", "class": "car"}
    seen = {"filter": filters, "snapshot": snapshot(api, dataset, **filters)}

    blind = bulk(api, dataset, "keep", filter=filters, expected_count=3)
    wrong = bulk(api, dataset, "keep", **seen, expected_count=4)
    right = bulk(api, dataset, "keep", **seen, expected_count=3)

    assert [each.status_code for each in (blind, wrong, right)] == [422, 409, 201]
    assert "snapshot" in blind.json()["detail"]
    assert wrong.json()["code"] == "count_changed"
    assert "3" in wrong.json()["detail"]
    assert wrong.json()["found"] == 3
    assert right.json()["count"] == 3
    assert effective(api, dataset) == 6


NOT_ACCEPTED: tuple[tuple[dict[str, object], int], ...] = (
    ({}, 422),
    ({"box_ids": [1], "filter": {}}, 422),
    ({"box_ids": [0]}, 422),
    ({"box_ids": ["x"]}, 422),
    ({"box_ids": [1, 2], "expected_count": 1}, 409),
    ({"box_ids": [1, 2], "seen_revisions": [0]}, 422),
    ({"box_ids": [1, 1], "seen_revisions": [0, 1]}, 422),
    ({"box_ids": [1], "seen_revisions": [-1]}, 422),
    ({"box_ids": [1], "snapshot": "W10"}, 422),
    ({"filter": {}, "expected_count": 0}, 422),
    ({"filter": {}, "seen_revisions": []}, 422),
    ({"filter": {}, "snapshot": ""}, 422),
    ({"filter": {}, "snapshot": "W10"}, 422),
    ({"filter": {}, "snapshot": "\u00fc"}, 422),
    ({"filter": {}, "snapshot": "WyJ4IiwxZTk5OSwwLDAsMF0"}, 422),
    ({"filter": {"colour": "blue"}, "snapshot": NO_BOXES}, 422),
    ({"filter": {"reason": "magic"}, "snapshot": NO_BOXES}, 400),
)


def test_invalid_bulk_answer_or_snapshot_is_refused(api, dataset):
    for which, status in NOT_ACCEPTED:
        assert bulk(api, dataset, "keep", **which).status_code == status, which
    present = json.loads(base64.urlsafe_b64decode(snapshot(api, dataset) + "=="))
    for place, number in product((1, 2, 3, 4), (-1, 2**63)):
        values = [*present[:place], number, *present[place + 1 :]]
        forged = base64.urlsafe_b64encode(json.dumps(values).encode()).decode()

        response = bulk(api, dataset, "keep", filter={}, snapshot=forged)

        refusal = (response.status_code, response.json()["code"])
        assert refusal == (422, "bad_snapshot"), values
        assert "one from the response of a list of boxes" in response.json()["detail"]
    assert api.json(f"/datasets/{dataset}/stats")["reviewed"] == 0


def test_a_bulk_answer_without_boxes_changes_nothing(api, dataset):
    response, too_long, missing = (
        bulk(api, name, "keep", box_ids=[]) for name in (dataset, "x" * 101, "x" * 100)
    )

    assert (response.status_code, response.json()["count"]) == (201, 0)
    assert undo(api, response.json()["id"]).json()["undone"] == 0
    assert undo(api, 2**40).status_code == 404
    assert (too_long.status_code, missing.status_code) == (422, 404)
    assert too_long.json()["errors"][0]["pointer"] == "/dataset"


def test_bulk_answer_by_ids_alone_skips_answered_boxes_as_stale(api, dataset, ghosts):
    api.review(ghosts[0], "keep", comment="nobody who sends ids alone saw this")
    api.review(ghosts[1], "reject")
    api.review(ghosts[1], "clear", 1)

    ids = [*ghosts, 2**62]
    batch = bulk(api, dataset, "reject", box_ids=ids, looked_at=1).json()

    assert (batch["count"], batch["skipped"]) == (2, [2**62])
    assert batch["stale"] == ghosts[:1]
    said = [api.json(f"/boxes/{box}")["review"]["verdict"] for box in ghosts]
    assert said == ["keep", "reject", "reject"]
    (entry, *_) = api.json(f"/boxes/{ghosts[1]}/history")["items"]
    assert (entry["batch_size"], entry["looked_at"]) == (2, 1)


def test_bulk_answer_skips_boxes_answered_since_as_stale(api, dataset, ghosts):
    api.review(ghosts[0], "unsure")
    seen = [1, 0, 0]
    api.review(ghosts[1], "keep", comment="first")

    batch = bulk(api, dataset, "reject", box_ids=ghosts, seen_revisions=seen).json()

    assert (batch["count"], batch["skipped"], batch["stale"]) == (2, [], ghosts[1:2])
    review = api.json(f"/boxes/{ghosts[1]}")["review"]
    assert (review["verdict"], review["comment"]) == ("keep", "first")
    undone = undo(api, batch["id"]).json()
    assert (undone["undone"], undone["skipped"]) == (2, [])
    said = [api.json(f"/boxes/{box}")["review"] for box in ghosts]
    assert [review and review["verdict"] for review in said] == ["unsure", "keep", None]


def add_frame(api, dataset, boxes):
    api.upload_frame(dataset, "3", {**scene.annotation(), "number": 3})


def delete_frame(api, dataset, boxes):
    assert api.delete(f"/datasets/{dataset}/frames/0").status_code == 204


def delete_and_add_frame(api, dataset, boxes):
    delete_frame(api, dataset, boxes)
    add_frame(api, dataset, boxes)


def replace_frame(api, dataset, boxes):
    api.upload_frame(dataset, "0", {**scene.annotation(), "number": 9}, replace=True)


def answer_one_box(api, dataset, boxes):
    assert api.review(boxes[0], "keep").status_code == 201


def answer_and_clear_one_box(api, dataset, boxes):
    api.review(boxes[0], "keep")
    assert api.review(boxes[0], "clear", 1).status_code == 201


def run_other_threshold(api, dataset, boxes):
    assert api.run(dataset, {"threshold_small_box": 8})["state"] == "done"


@pytest.mark.parametrize(
    ("meanwhile", "total", "changed"),
    [
        (add_frame, 4, 1),
        (delete_frame, 2, 0),
        (delete_and_add_frame, 3, 1),
        (replace_frame, 3, 1),
        (answer_one_box, 3, 1),
        (answer_and_clear_one_box, 3, 1),
        (run_other_threshold, 3, 3),
    ],
)
def test_bulk_answer_on_a_stale_filter_snapshot_returns_412(
    api, dataset, ghosts, meanwhile, total, changed
):
    chosen = {"filter": {"verdict": "rejected"}}
    seen = snapshot(api, dataset, verdict="rejected")
    meanwhile(api, dataset, ghosts)
    reviewed = api.json(f"/datasets/{dataset}/stats")["reviewed"]

    stale = bulk(api, dataset, "reject", **chosen, snapshot=seen, expected_count=3)

    problem = stale.json()
    assert (stale.status_code, problem["code"]) == (412, "stale_snapshot")
    now = snapshot(api, dataset, verdict="rejected")
    assert problem["current"] == {"total": total, "snapshot": now}
    assert problem["detail"] == (
        f"the filter selects {total} boxes now, 3 when they were listed; "
        f"added, decided again or answered since then: {changed}"
    )
    assert api.json(f"/datasets/{dataset}/stats")["reviewed"] == reviewed
    again = bulk(api, dataset, "reject", **chosen, snapshot=now)
    assert (again.status_code, again.json()["count"]) == (201, total)


def test_answers_outside_the_filter_do_not_make_its_snapshot_stale(
    api, dataset, ghosts
):
    seen = snapshot(api, dataset, verdict="rejected", review="none")
    (kept, *_) = api.boxes(dataset, verdict="kept")
    api.review(kept["box_id"], "keep")
    elsewhere = api.upload_frame(api.dataset(), "a")["decisions"][0]["box_id"]
    api.review(elsewhere, "keep")

    response = bulk(
        api,
        dataset,
        "reject",
        filter={"verdict": "rejected", "review": "none"},
        snapshot=seen,
    )

    assert (response.status_code, response.json()["count"]) == (201, 3)


def test_snapshot_of_another_filter_or_dataset_is_refused(api, dataset):
    seen = snapshot(api, dataset, verdict="rejected")
    other = api.dataset()
    api.upload_frame(other, "0")

    wrong = [
        bulk(api, dataset, "keep", filter={"verdict": "kept"}, snapshot=seen),
        bulk(api, other, "keep", filter={"verdict": "rejected"}, snapshot=seen),
    ]

    assert [response.status_code for response in wrong] == [422, 422]
    assert {response.json()["code"] for response in wrong} == {"bad_snapshot"}


def test_answer_that_came_at_the_same_moment_makes_others_stale(service):
    """The second box has an answer that its decision does not show yet."""
    api = Api(service.admin())
    with api.http:
        name = api.dataset()
        boxes = [box["box_id"] for box in api.upload_frame(name, "0")["decisions"]]
        with service.app.state.database.write() as session:
            answer = {"box_id": boxes[1], "revision": 1, "verdict": "keep"}
            session.execute(insert(Review), {**answer, "reviewer": "ada"})
        seen = snapshot(api, name)

        single = api.review(boxes[1], "reject")
        by_filter = bulk(api, name, "reject", filter={}, snapshot=seen)
        unchanged = api.json(f"/boxes/{boxes[0]}")["review"]
        listed = bulk(api, name, "reject", box_ids=boxes)
        undone = undo(api, listed.json()["id"]).json()["undone"]

    assert (single.status_code, single.json()["code"]) == (412, "stale_review")
    assert "is at revision 1, you reviewed revision 0" in single.json()["detail"]
    assert (by_filter.status_code, by_filter.json()["code"]) == (412, "stale_snapshot")
    assert by_filter.json()["current"] == {"total": len(boxes), "snapshot": seen}
    assert unchanged is None
    assert listed.status_code == 201
    assert listed.json()["stale"] == boxes[1:2]
    assert listed.json()["count"] == undone == len(boxes) - 1
