"""Reviewers cannot delete, undo or discard answers of others; admins can."""

import json
from itertools import count

import pytest

from tests.support import archives
from tests.support import frames as scene
from tests.support.api import BASE, Api

MOVED = {**scene.annotation(), "boxes": [], "map": "Town01"}
_names = count(1)


@pytest.fixture
def person(service, admin):
    """Makes a person with a role and a token of their own: their name, and a client."""
    opened = []

    def make(role="reviewer"):
        name = f"person-{next(_names)}"
        token = admin.post(f"{BASE}/tokens", json={"name": name, "role": role}).json()
        api = Api(service.client(Authorization=f"Bearer {token['token']}"))
        opened.append(api.http)
        return name, api

    yield make
    for client in opened:
        client.close()


@pytest.fixture
def street(admin):
    """A dataset of two frames, and the ids of the first one's boxes."""
    api = Api(admin)
    name = f"street-{next(_names)}"
    api.post("/datasets", {"name": name})
    first = api.upload_frame(name, "0")
    api.upload_frame(name, "1", {**scene.annotation(), "number": 1})
    return name, [box["box_id"] for box in first["decisions"]]


def delete(api, name):
    return api.delete(f"/datasets/{name}/frames/0")


def replace(api, name):
    return api.put(name, "0", MOVED, replace=True)


def replace_in_a_batch(api, name):
    """Replace the frame in a batch; return the line about it.

    The batch has another new frame, which must be stored in any case.
    """
    other = {**scene.annotation(), "map": "Town02"}
    documents = {"0": MOVED, "1": other}
    members = [
        (f"{key}.json", json.dumps({**document, "key": key}).encode())
        for key, document in documents.items()
    ]
    archive = archives.tar_archive(members)
    response = archives.send(api, name, archive, replace="true")
    *lines, _ = archives.lines_of(response.text)
    lines_by_key = {line["key"]: line for line in lines}
    assert lines_by_key["1"]["status"] == 201
    return lines_by_key["0"]


def refusal(response):
    """The status, code and detail of an answer or of a line of a batch."""
    if isinstance(response, dict):
        problem = response.get("problem", {})
        return response["status"], problem.get("code"), problem.get("detail", "")
    problem = response.json() if response.content else {}
    return response.status_code, problem.get("code"), problem.get("detail", "")


WAYS_TO_DISCARD = [delete, replace, replace_in_a_batch]


@pytest.mark.parametrize("discard", WAYS_TO_DISCARD)
def test_reviewer_may_not_discard_answers_of_others(street, person, discard):
    name, boxes = street
    (grace, hers), (ada, his) = person(), person()
    assert hers.review(boxes[1], "keep", comment="there is one").status_code == 201
    assert his.review(boxes[0], "keep").status_code == 201

    status, code, detail = refusal(discard(his, name))

    assert (status, code) == (403, "others_answers")
    assert f"1 answer of {grace}" in detail
    assert f"the role admin, token {ada!r} has reviewer" in detail
    review = his.json(f"/boxes/{boxes[1]}")["review"]
    assert (review["verdict"], review["comment"]) == ("keep", "there is one")
    assert his.json(f"/datasets/{name}/frames/0")["revision"] == 1


@pytest.mark.parametrize("discard", WAYS_TO_DISCARD)
def test_reviewer_may_discard_their_own_answers(street, person, discard):
    name, boxes = street
    _, api = person()
    assert api.review(boxes[0], "keep").status_code == 201

    status, _, detail = refusal(discard(api, name))

    assert status in (201, 204), detail


@pytest.mark.parametrize("discard", WAYS_TO_DISCARD)
def test_admin_may_discard_answers_of_others_and_it_is_audited(
    street, person, admin, discard
):
    name, boxes = street
    _, hers = person()
    (boss, his) = person("admin")
    assert hers.review(boxes[0], "keep").status_code == 201
    assert his.review(boxes[1], "keep").status_code == 201

    status, _, detail = refusal(discard(his, name))

    assert status in (201, 204), detail
    entry = next(
        entry
        for entry in admin.get(f"{BASE}/audit").json()["items"]
        if entry["details"].get("dataset") == name and entry["subject"] == "0"
    )
    action = "frame.deleted" if discard is delete else "frame.replaced"
    assert (entry["actor"], entry["action"]) == (boss, action)
    assert entry["details"]["answers"] == 2
    assert entry["details"]["of_others"] == 1


def test_reviewer_may_replace_a_frame_if_answers_are_carried_over(street, person):
    name, boxes = street
    (grace, hers), (_, his) = person(), person()
    assert hers.review(boxes[1], "keep").status_code == 201

    response = his.put(name, "0", {**scene.annotation(), "map": "Town03"}, replace=True)

    assert response.status_code == 201, response.text
    (carried,) = his.boxes(name, review="keep")
    assert carried["review"]["reviewer"] == grace


def test_cleared_answer_of_others_allows_replacing_but_not_deleting(street, person):
    name, boxes = street
    (_, hers), (_, his) = person(), person()
    hers.review(boxes[1], "keep")
    hers.review(boxes[1], "clear", 1)

    replaced, deleted = replace(his, name), delete(his, name)

    assert replaced.status_code == 201, replaced.text
    assert refusal(deleted)[:2] == (403, "others_answers")
    assert "2 answers of" in deleted.json()["detail"]


def test_bulk_answer_is_undone_only_by_its_reviewer_or_an_admin(street, person, admin):
    name, boxes = street
    (grace, hers), (_, his), (boss, admins) = person(), person(), person("admin")
    body = {"dataset": name, "box_ids": boxes, "verdict": "keep"}
    batch = hers.post("/reviews/bulk", body).json()["id"]
    undo = f"/review-batches/{batch}/undo"

    refused = his.post(undo)
    undone = admins.post(undo)
    again = hers.post(f"/review-batches/{undone.json()['id']}/undo")
    body = {**body, "verdict": "reject"}
    own = his.post("/reviews/bulk", body).json()["id"]

    assert refusal(refused)[:2] == (403, "others_answers")
    assert (
        f"undoing bulk answer {batch} affects 2 answers of {grace}"
        in refusal(refused)[2]
    )
    assert undone.json()["undone"] == 2
    assert (again.status_code, boss in again.json()["detail"]) == (403, True)
    assert his.post(f"/review-batches/{own}/undo").json()["undone"] == 2
    items = admin.get(f"{BASE}/audit").json()["items"]
    noted = [entry for entry in items if entry["details"].get("dataset") == name]
    assert [(entry["actor"], entry["action"]) for entry in noted[2:4]] == [
        (boss, "review_batch.undone"),
        (grace, "review_batch.created"),
    ]
    assert noted[3]["subject"] == noted[2]["subject"] == str(batch)
    assert noted[3]["details"] == {
        "dataset": name,
        "verdict": "keep",
        "answers": 2,
        "skipped": 0,
    }
    assert (noted[2]["details"]["answers"], noted[2]["details"]["skipped"]) == (2, 0)


def clear_one(api, name, boxes):
    seen = api.json(f"/boxes/{boxes[1]}")["revision"]
    return api.review(boxes[1], "clear", seen)


def clear_filter(api, name, boxes):
    seen = api.json("/boxes", dataset=name, review="any", count="true")["snapshot"]
    body = {"dataset": name, "verdict": "clear", "filter": {"review": "any"}}
    return api.post("/reviews/bulk", {**body, "snapshot": seen})


def clear_all(api, name, boxes):
    body = {"dataset": name, "box_ids": boxes, "verdict": "clear"}
    seen = [api.json(f"/boxes/{box_id}")["revision"] for box_id in boxes]
    return api.post("/reviews/bulk", {**body, "seen_revisions": seen})


def answer_and_replace(api, name, boxes):
    """Answer the boxes as well, then replace the frame: only that is carried over."""
    for box_id in boxes:
        seen = api.json(f"/boxes/{box_id}")["revision"]
        assert api.review(box_id, "reject", seen=seen).status_code == 201
    return api.put(name, "0", {**scene.annotation(), "number": 9}, replace=True)


WAYS_TO_CLEAR = [clear_one, clear_all, clear_filter]


@pytest.mark.parametrize("clear", WAYS_TO_CLEAR)
@pytest.mark.parametrize("is_overruled", [False, True])
def test_answers_of_others_are_cleared_only_by_an_admin(
    street, person, admin, clear, is_overruled
):
    name, boxes = street
    (grace, hers), (_, his), (boss, admins) = person(), person(), person("admin")
    assert hers.review(boxes[1], "keep", comment="there is one").status_code == 201
    if is_overruled:  # clearing the own answer would clear hers, too
        assert his.review(boxes[1], "reject", 1).status_code == 201

    status, code, detail = refusal(clear(his, name, boxes))

    assert (status, code) == (403, "others_answers")
    assert f"affects 1 answer of {grace}: this needs the role admin" in detail
    assert his.json(f"/boxes/{boxes[1]}")["revision"] == 1 + is_overruled
    assert clear(admins, name, boxes).status_code == 201
    assert his.json(f"/boxes/{boxes[1]}")["review"] is None
    items = admin.get(f"{BASE}/audit").json()["items"]
    noted = next(entry for entry in items if entry["details"].get("dataset") == name)
    action = "review.cleared" if clear is clear_one else "review_batch.created"
    assert (noted["actor"], noted["action"]) == (boss, action)
    assert noted["details"]["of_others"] == 1 + is_overruled


@pytest.mark.parametrize("clear", WAYS_TO_CLEAR)
def test_reviewer_clears_own_answers_and_those_that_others_took_back(
    street, person, clear
):
    name, boxes = street
    (_, hers), (_, his) = person(), person()
    assert hers.review(boxes[1], "keep").status_code == 201
    assert hers.post(f"/boxes/{boxes[1]}/reviews/1/undo").status_code == 201
    assert his.review(boxes[1], "reject", 2).status_code == 201

    cleared = clear(his, name, boxes)

    assert cleared.status_code == 201, cleared.text
    assert his.json(f"/boxes/{boxes[1]}")["review"] is None


@pytest.mark.parametrize("discard", WAYS_TO_DISCARD)
@pytest.mark.parametrize("first", [clear_all, answer_and_replace])
def test_reviewer_may_not_discard_cleared_or_overruled_answers_of_others(
    street, person, discard, first
):
    name, boxes = street
    (grace, hers), (_, his), (_, admins) = person(), person(), person("admin")
    assert hers.review(boxes[1], "keep", comment="there is one").status_code == 201
    assert first(admins if first is clear_all else his, name, boxes).is_success

    status, code, detail = refusal(discard(his, name))

    assert (status, code) == (403, "others_answers")
    assert grace in detail


def test_answer_is_undone_only_by_its_reviewer_or_an_admin(street, person, admin):
    name, boxes = street
    (grace, hers), (_, his), (boss, admins) = person(), person(), person("admin")
    undo = f"/boxes/{boxes[0]}/reviews/{{}}/undo".format
    hers.review(boxes[0], "keep")

    refused = refusal(his.post(undo(1)))

    assert refused[:2] == (403, "others_answers")
    assert (
        f"undoing answer 1 on box {boxes[0]} affects 1 answer of {grace}" in refused[2]
    )
    assert admins.post(undo(1)).status_code == 201
    hers.review(boxes[0], "reject", 2)
    assert hers.post(undo(3)).status_code == 201
    items = admin.get(f"{BASE}/audit").json()["items"]
    noted = [entry for entry in items if entry["action"] == "review.undone"]
    assert [
        (entry["actor"], entry["subject"], entry["details"]) for entry in noted[:1]
    ] == [(boss, str(boxes[0]), {"dataset": name, "revision": 1, "reviewer": grace})]


@pytest.mark.parametrize("is_undone_before", [False, True])
def test_answer_counts_where_an_admin_has_undone_it_or_its_undo(
    street, person, is_undone_before
):
    name, boxes = street
    (grace, hers), (_, his), (_, admins) = person(), person(), person("admin")
    hers.review(boxes[0], "keep")
    if is_undone_before:
        hers.post(f"/boxes/{boxes[0]}/reviews/1/undo")
    latest = 2 if is_undone_before else 1
    undone = admins.post(f"/boxes/{boxes[0]}/reviews/{latest}/undo")
    assert undone.status_code == 201

    assert grace in refusal(replace(his, name))[2]


def test_undone_answer_over_another_one_does_not_count_as_discarded(street, person):
    name, boxes = street
    (_, hers), (_, his) = person(), person()
    hers.review(boxes[0], "reject")
    his.review(boxes[0], "keep", 1)
    his.post(f"/boxes/{boxes[0]}/reviews/2/undo")

    assert replace(hers, name).status_code == 201


def test_answer_that_was_carried_over_and_then_undone_does_not_count(street, person):
    name, boxes = street
    (_, hers), (_, his) = person(), person()
    his.review(boxes[1], "keep")
    town = {**scene.annotation(), "map": "Town02"}
    replaced = his.put(name, "0", town, replace=True).json()
    carried = replaced["decisions"][1]["box_id"]
    assert his.post(f"/boxes/{carried}/reviews/1/undo").status_code == 201

    assert replace(hers, name).status_code == 201


def test_answer_that_an_undo_repeats_is_carried_over_as_its_author_s(street, person):
    name, boxes = street
    (grace, hers), (_, his) = person(), person()
    hers.review(boxes[1], "keep", comment="there is one")
    his.review(boxes[1], "reject", 1)
    his.post(f"/boxes/{boxes[1]}/reviews/2/undo")
    town = {**scene.annotation(), "map": "Town02"}

    replaced = hers.put(name, "0", town, replace=True).json()

    review = hers.json(f"/boxes/{replaced['decisions'][1]['box_id']}")["review"]
    assert (review["reviewer"], review["comment"]) == (grace, "there is one")
    assert replace(hers, name).status_code == 201


def test_reviewer_may_replace_a_frame_after_clearing_own_answers(street, person):
    name, boxes = street
    _, his = person()
    assert his.review(boxes[1], "keep").status_code == 201
    assert clear_all(his, name, boxes).is_success

    assert replace(his, name).status_code == 201
