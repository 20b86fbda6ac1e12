"""The queue: its order, its filters, and that no two people get the same box."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from datetime import datetime, timedelta, timezone
from typing import Any

import pytest

from app.review.queue import MOST_CLAIMS
from tests.support import frames as scene
from tests.support.api import BASE, Api


@pytest.fixture
def dataset(api):
    """A frame with six times a car and a ghost."""
    name = api.dataset()
    annotation: dict[str, Any] = scene.annotation()
    boxes = [
        {**box, "id": f"{box['id']}-{number}"}
        for number in range(6)
        for box in annotation["boxes"]
    ]
    api.upload_frame(name, "a", {**annotation, "boxes": boxes})
    return name


@pytest.fixture
def reviewer(api):
    """Makes clients of reviewers."""
    with ExitStack() as opened:

        def make() -> Api:
            person: Api = api.person()
            opened.enter_context(person.http)
            return person

        yield make


def get_queue(api, dataset, **body):
    """The queue of all boxes that nobody has decided, in doubt or not."""
    if "filters" not in body and body.get("order") != "audit":
        body["filters"] = {"review": "undecided"}
    response = api.post(f"/datasets/{dataset}/queue", body)
    assert response.status_code == 200, response.text
    return response.json()


def ids(queue):
    return [item["box_id"] for item in queue["items"]]


def test_queue_returns_decisions_with_a_claim_that_expires(api, dataset):
    before = datetime.now(timezone.utc)

    queue = get_queue(api, dataset, limit=2)

    first = queue["items"][0]
    until = datetime.fromisoformat(first.pop("claim")["expires_at"][:-1] + "+00:00")
    shown = api.json(f"/boxes/{first['box_id']}")
    assert first == {key: shown[key] for key in shown if key != "neighbours"}
    assert timedelta(minutes=4) < until - before < timedelta(minutes=6)
    counts = [queue[name] for name in ("remaining", "unsure", "claimed_by_others")]
    assert counts == [12, 0, 0]


def test_queue_has_the_order_of_the_list_without_excluded_and_answered_boxes(
    api, dataset
):
    listed = [box["box_id"] for box in api.boxes(dataset, sort="doubt")]
    assert ids(get_queue(api, dataset, limit=50)) == listed
    assert ids(get_queue(api, dataset, limit=5, exclude=listed[:5])) == listed[5:10]

    api.review(listed[0], "keep")
    queue = get_queue(api, dataset, limit=50)
    assert (ids(queue), queue["remaining"]) == (listed[1:], 11)

    api.review(listed[1], "unsure")
    queue = get_queue(api, dataset, limit=50)
    assert ids(queue) == [*listed[2:], listed[1]]
    assert (queue["remaining"], queue["unsure"]) == (10, 1)


def test_response_of_the_queue_is_not_kept_for_an_idempotency_key(api, dataset):
    """It has all data of many boxes, and a repeated request may get others."""
    request = {"url": f"{BASE}/datasets/{dataset}/queue", "json": {}}

    responses = [
        api.http.post(**request, headers={"Idempotency-Key": f"queue-of-{dataset}"})
        for _ in range(2)
    ]

    assert [response.status_code for response in responses] == [200, 200]
    assert not any("idempotent-replayed" in response.headers for response in responses)
    assert responses[0].headers["cache-control"] == "no-store"


def test_box_is_claimed_by_one_reviewer_until_it_is_answered(dataset, reviewer):
    ada, eve = reviewer(), reviewer()
    hers = ids(get_queue(ada, dataset, limit=7))

    others = get_queue(eve, dataset, limit=50)
    again = ids(get_queue(ada, dataset, limit=7))
    freely = eve.review(hers[0], "keep")

    assert not set(hers) & set(ids(others))
    assert len(others["items"]) == 5
    assert others["claimed_by_others"] == 7
    assert others["remaining"] == 12
    assert again == hers
    assert freely.status_code == 201
    assert get_queue(eve, dataset)["claimed_by_others"] == 6


def test_one_reviewer_holds_only_a_share_of_the_queue(api, reviewer):
    dataset, boxes = api.dataset_of_cars(MOST_CLAIMS + 60)
    greedy, other = reviewer(), reviewer()
    taken: list[int] = []
    while len(taken) < len(boxes):
        taken += ids(get_queue(greedy, dataset, limit=50, exclude=taken))

    queue = get_queue(other, dataset, limit=50)
    again = get_queue(greedy, dataset, limit=50, order="random", seed=1)

    assert queue["claimed_by_others"] == MOST_CLAIMS
    assert len(ids(queue)) == 50
    assert not set(ids(queue)) & set(taken[-MOST_CLAIMS:])
    assert get_queue(other, dataset)["claimed_by_others"] == MOST_CLAIMS
    assert not set(ids(queue)) & set(ids(again))


def test_concurrent_reviewers_never_get_the_same_box(api, reviewer):
    dataset, _ = api.dataset_of_cars(40)
    clients = [reviewer() for _ in range(8)]
    orders = ["doubt", "random", "class", "random"]

    def ask_often(number: int) -> set[int]:
        order = orders[number % 4]
        responses = [get_queue(clients[number], dataset, order=order, limit=3)]
        responses.append(
            get_queue(
                clients[number],
                dataset,
                order=order,
                limit=2,
                exclude=ids(responses[0]),
            )
        )
        return {box_id for response in responses for box_id in ids(response)}

    with ThreadPoolExecutor(8) as pool:
        boxes = list(pool.map(ask_often, range(8)))

    assert [len(part) for part in boxes] == [5] * 8
    assert len(set().union(*boxes)) == 40


def test_queue_by_class_follows_the_order_of_the_classes(api):
    name = api.dataset(classes=["walker", "car"])
    boxes = [{"class": of, "xyxy": scene.ON_THE_CAR} for of in ("car", "walker", "car")]
    api.upload_frame(name, "0", {**scene.annotation(), "boxes": boxes})

    queue = get_queue(api, name, order="class")

    assert [item["class"] for item in queue["items"]] == ["walker", "car", "car"]


def test_random_order_is_reproducible_by_its_seed(api, dataset):
    def queued_ids(**more):
        return ids(get_queue(api, dataset, order="random", limit=50, **more))

    seeds = [queued_ids(seed=seed) for seed in range(8)]

    assert queued_ids() == queued_ids()
    assert queued_ids(seed=3) == seeds[3]
    assert len({tuple(ids) for ids in seeds}) > 4
    assert {len(set(ids)) for ids in seeds} == {12}


def test_audit_queue_has_the_boxes_that_others_have_decided(api, dataset, reviewer):
    eve, boxes = reviewer(), api.box_ids(dataset)
    for box_id, verdict in zip(boxes, ["keep", "reject", "unsure"], strict=False):
        api.review(box_id, verdict)

    queue = get_queue(eve, dataset, order="audit")
    kept = get_queue(eve, dataset, order="audit", filters={"review": "keep"})
    eve.review(boxes[0], "reject", 1)

    assert sorted(ids(queue)) == boxes[:2]
    assert (queue["remaining"], queue["unsure"]) == (2, 0)
    assert ids(kept) == boxes[:1]
    assert ids(get_queue(eve, dataset, order="audit")) == boxes[1:2]
    own = get_queue(api, dataset, order="audit")
    assert (ids(own), own["remaining"]) == ([], 0)


def test_answer_keeps_how_the_queue_chose_its_box(api, dataset, reviewer):
    eve = reviewer()

    def chosen(box_id: int) -> dict[str, object]:
        entry = api.json(f"/boxes/{box_id}/history")["items"][0]
        return {name: entry.get(name) for name in ("chosen_by", "chosen_from")}

    first, second = ids(get_queue(eve, dataset, limit=2, filters={"class": "car"}))
    eve.review(first, "keep")
    api.review(second, "keep")
    drawn = ids(get_queue(eve, dataset, order="random", limit=3))
    seeded = ids(get_queue(api, dataset, order="random", limit=1, seed=5))
    eve.review(drawn[0], "keep")
    body = {"dataset": dataset, "verdict": "keep", "box_ids": [drawn[1]]}
    eve.post("/reviews/bulk", body)
    api.review(seeded[0], "keep")

    assert chosen(first) == {"chosen_by": "doubt", "chosen_from": {"class": "car"}}
    at_random = {"chosen_by": "random", "chosen_from": {"review": "undecided"}}
    assert chosen(drawn[0]) == chosen(seeded[0]) == at_random
    for box_id in (second, drawn[1]):  # without a claim of its author; in bulk
        assert chosen(box_id) == {"chosen_by": None, "chosen_from": None}
    entries = [
        api.json(f"/boxes/{box_id}/history")["items"][0]
        for box_id in (drawn[0], seeded[0])
    ]
    assert 0 < entries[0]["probability"] <= 1
    assert entries[1]["probability"] is None


def test_queue_applies_the_filters_of_lists_in_every_order(api, dataset):
    ghosts = api.box_ids(dataset, verdict="rejected")
    filters = {"verdict": "rejected", "class": "car"}
    near = get_queue(api, dataset, filters={**filters, "distance_min": 1})
    queue = get_queue(api, dataset, filters=filters)
    assert near["items"] == []
    assert len(queue["items"]) == queue["remaining"] == 6

    api.review(ghosts[0], "keep")
    api.review(ghosts[1], "reject")

    for order in ("doubt", "random", "class"):
        queue = get_queue(api, dataset, order=order, filters={"conflict": True})
        assert (ids(queue), queue["remaining"]) == (ghosts[:1], 1)
    assert api.json(f"/datasets/{dataset}/stats")["conflicts"] == 1


NOT_ACCEPTED = (
    ({"order": "newest"}, 422),
    ({"limit": 0}, 422),
    ({"limit": 51}, 422),
    ({"exclude": [0]}, 422),
    ({"exclude": list(range(1, 1002))}, 422),
    ({"seed": 2**63}, 422),
    ({"filters": {"colour": "red"}}, 422),
    ({"filters": {"review": "maybe"}}, 400),
    ({"filters": {"reason": "magic"}}, 400),
)


def test_an_empty_dataset_has_an_empty_queue_and_invalid_requests_are_refused(api):
    name = api.dataset()

    for order in ("doubt", "random", "class", "audit"):
        queue = get_queue(api, name, order=order)
        assert queue.pop("items") == []
        assert queue == dict.fromkeys(("remaining", "unsure", "claimed_by_others"), 0)
    for body, status in NOT_ACCEPTED:
        assert api.post(f"/datasets/{name}/queue", body).status_code == status, body
