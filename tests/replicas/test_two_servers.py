"""Two servers that share one database behave together as one server does."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from app.access.gate import REMEMBERED_S
from tests.support import frames as scene
from tests.support import plain_http
from tests.support.api import BASE, Api
from tests.support.event_reader import events, open_events
from tests.support.slow_datasets import FROM_PIXELS, create_slow_dataset

PATIENCE_S = 60


def both_at_once(first, second):
    """Call two functions at the same time, and give both results."""
    with ThreadPoolExecutor(2) as pool:
        futures = [pool.submit(first), pool.submit(second)]
        return [future.result() for future in futures]


def until_refused(client, path="/api/v1/datasets"):
    """Ask until the answer is 401; give when the last accepted request was sent.

    In seconds from the beginning. The time of sending counts and not that of the
    answer, which may be late on a busy machine.
    """
    begun, last_sent_s = time.monotonic(), 0.0
    while True:
        sent_s = time.monotonic() - begun
        if client.get(path).status_code == 401:
            return last_sent_s
        last_sent_s = sent_s
        assert sent_s < PATIENCE_S
        time.sleep(0.02)


def test_servers_that_share_a_folder_share_the_first_token(replicas):
    assert replicas.one.server.token == replicas.two.server.token
    assert replicas.two.api.get("/session").json()["role"] == "admin"


def test_a_code_and_a_session_of_one_are_those_of_the_other(replicas):
    one, two = replicas.one.server.url, replicas.two.server.url
    code = replicas.two.server.login_link.partition("/#code=")[2]
    opened = plain_http.post(f"{one}/api/v1/session", json={"code": code})
    again = plain_http.post(f"{two}/api/v1/session", json={"code": code})
    shown = {"Authorization": f"Bearer {opened.json()['session']}"}
    with plain_http.Client(base_url=two, headers=shown) as browser:
        known = browser.get("/api/v1/session")
        browser.delete("/api/v1/session")
    with plain_http.Client(base_url=one, headers=shown) as browser:
        last_sent_s = until_refused(browser)

    assert (opened.status_code, again.status_code) == (201, 401)
    assert known.json()["name"] == "admin"
    assert last_sent_s < REMEMBERED_S


def test_a_token_that_is_revoked_opens_neither_a_second_later(replicas):
    made = replicas.one.api.post("/tokens", {"name": "eve", "role": "viewer"}).json()
    headers = {"Authorization": f"Bearer {made['token']}"}
    with (
        Api.at(replicas.one.server.url, headers).http as one,
        Api.at(replicas.two.server.url, headers).http as two,
    ):
        assert [each.get("/version").status_code for each in (one, two)] == [200, 200]

        revoked = replicas.one.api.http.delete(f"{BASE}/tokens/{made['id']}")
        here = one.get("/version").status_code
        last_sent_s = until_refused(two)

    assert (revoked.status_code, here) == (204, 401)
    assert last_sent_s < REMEMBERED_S


def test_of_two_answers_on_one_box_one_counts_and_the_other_is_stale(
    replicas, make_reviewer
):
    (ada, _), (_, bob) = make_reviewer(), make_reviewer()
    name = replicas.make_dataset(frames=10)
    boxes = [box["box_id"] for box in ada.boxes(name)]

    for box_id in boxes:
        answers = both_at_once(
            partial(ada.review, box_id, "keep"), partial(bob.review, box_id, "reject")
        )
        assert sorted(answer.status_code for answer in answers) == [201, 412]
        (won,) = [answer.json() for answer in answers if answer.status_code == 201]
        (lost,) = [answer.json() for answer in answers if answer.status_code == 412]
        shown = [each.api.json(f"/boxes/{box_id}") for each in replicas.both]
        assert shown[0] == shown[1]
        assert shown[0]["review"]["verdict"] == won["verdict"]
        assert lost["current"]["review"]["revision"] == 1
    found = [each.api.json(f"/datasets/{name}/stats") for each in replicas.both]
    assert found[0] == found[1]


def test_of_two_acts_on_the_same_boxes_each_box_counts_in_one(replicas, make_reviewer):
    (ada, _), (_, bob) = make_reviewer(), make_reviewer()
    name = replicas.make_dataset(frames=10)
    boxes = [box["box_id"] for box in ada.boxes(name)]

    for act in range(10):
        seen = [act] * len(boxes)
        which = {"dataset": name, "box_ids": boxes, "seen_revisions": seen}
        answers = both_at_once(
            partial(ada.post, "/reviews/bulk", {"verdict": "keep", **which}),
            partial(bob.post, "/reviews/bulk", {"verdict": "reject", **which}),
        )
        assert [answer.status_code for answer in answers] == [201, 201]
        done = sorted((each.json() for each in answers), key=lambda one: one["count"])
        assert [one["count"] for one in done] == [0, len(boxes)]
        assert [one["stale"] for one in done] == [boxes, []]
        won = done[1]["verdict"]
        shown = [each.api.boxes(name) for each in replicas.both]
        assert shown[0] == shown[1]
        said = [(box["revision"], box["review"]["verdict"]) for box in shown[0]]
        assert said == [(act + 1, won)] * len(boxes)
        stats = replicas.one.api.json(f"/datasets/{name}/stats")
        assert (stats["reviewed"], stats["boxes"]) == (len(boxes), len(boxes))


def test_of_two_acts_on_one_filter_the_later_is_stale(replicas, make_reviewer):
    (ada, _), (_, bob) = make_reviewer(), make_reviewer()
    name = replicas.make_dataset(frames=5)

    for _ in range(5):
        page = ada.json("/boxes", dataset=name, count="true")
        which = {"dataset": name, "filter": {}, "snapshot": page["snapshot"]}
        answers = both_at_once(
            partial(ada.post, "/reviews/bulk", {"verdict": "keep", **which}),
            partial(bob.post, "/reviews/bulk", {"verdict": "reject", **which}),
        )
        assert sorted(answer.status_code for answer in answers) == [201, 412]
        (late,) = [answer.json() for answer in answers if answer.status_code == 412]
        assert late["code"] == "stale_snapshot"
        assert late["current"]["total"] == page["total"]


def test_a_key_that_is_sent_to_both_is_answered_once(replicas, make_reviewer):
    one, two = make_reviewer()
    name = replicas.make_dataset()
    box = one.boxes(name)[0]["box_id"]

    def send(api, number):
        path = f"{BASE}/boxes/{box}/reviews"
        body = {"verdict": "keep", "seen_revision": number}
        headers = {"Idempotency-Key": f"{name}-{number}"}
        return api.http.post(path, json=body, headers=headers)

    for number in range(10):
        first, second = both_at_once(
            partial(send, one, number), partial(send, two, number)
        )
        assert (first.status_code, second.status_code) == (201, 201), number
        assert first.content == second.content
        replayed = [each.headers.get("Idempotent-Replayed") for each in (first, second)]
        assert replayed.count("true") == 1
    assert one.json(f"/boxes/{box}")["review"]["revision"] == 10


def test_the_queue_hands_no_box_out_twice(replicas, make_reviewer):
    name = replicas.make_dataset(frames=20)
    clients = [make_reviewer()[number % 2] for number in range(6)]

    def take(number: int) -> list[int]:
        taken: list[int] = []
        for order in ("doubt", "random", "class"):
            wanted = {"limit": 2, "order": order, "exclude": taken}
            answer = clients[number].post(f"/datasets/{name}/queue", wanted)
            assert answer.status_code == 200, answer.text
            taken += [item["box_id"] for item in answer.json()["items"]]
        return taken

    with ThreadPoolExecutor(6) as pool:
        given = list(pool.map(take, range(6)))

    assert [len(one) for one in given] == [6] * 6
    assert len({box for one in given for box in one}) == 36


def test_a_batch_of_answers_is_undone_on_the_other(replicas, make_reviewer):
    one, two = make_reviewer()
    name = replicas.make_dataset(frames=4)
    ids = [box["box_id"] for box in one.boxes(name)]
    wanted = {"dataset": name, "box_ids": ids, "verdict": "reject"}

    batch = one.post("/reviews/bulk", wanted).json()
    seen = two.json(f"/datasets/{name}/stats")["effective"]["rejected"]
    undone = both_at_once(
        lambda: one.post(f"/review-batches/{batch['id']}/undo"),
        lambda: two.post(f"/review-batches/{batch['id']}/undo"),
    )

    assert (batch["count"], seen) == (8, 8)
    assert sorted(answer.status_code for answer in undone) == [200, 409]
    assert one.json(f"/datasets/{name}/stats")["effective"]["rejected"] == 4


def test_numbers_that_one_keeps_are_those_that_the_other_stored(replicas):
    one, two = (each.api for each in replicas.both)
    name = replicas.make_dataset(frames=2)
    preview = {"config": {"min_visible_pixels": 10**6}}

    def flips(api):
        answer = api.post(f"/datasets/{name}/preview", preview)
        assert answer.status_code == 200, answer.text
        return answer.json()["flips"]["total"]

    before = flips(one), flips(two)
    one.upload_frame(name, "more", {**scene.annotation(), "number": 77})
    added = flips(one), flips(two)
    two.http.delete(f"{BASE}/datasets/{name}/frames/000")
    removed = flips(one), flips(two)
    two.upload_frame(name, "more", {**scene.annotation(), "number": 78}, replace=True)
    replaced = flips(one), flips(two)
    ran = one.run(name, {"min_visible_pixels": 10**6})
    decided = flips(one), flips(two)

    assert (before, added, removed, replaced) == ((2, 2), (3, 3), (2, 2), (2, 2))
    assert (ran["changed"], decided) == (2, (0, 0))
    two.upload_frame(name, "last", {**scene.annotation(), "number": 79})
    assert two.json(f"/datasets/{name}/stats")["kept"] == 0


def test_a_configuration_that_one_made_active_decides_frames_on_the_other(replicas):
    one, two = (each.api for each in replicas.both)
    name = replicas.make_dataset(frames=2)

    for number in range(4):
        config = {} if number % 2 else {"min_visible_pixels": 10**6}
        replicas.both[number % 2].api.run(name, config)
        stored = replicas.both[1 - number % 2].api.upload_frame(
            name, f"after-{number}", {**scene.annotation(), "number": 100 + number}
        )
        verdicts = [decision["verdict"] for decision in stored["decisions"]]
        assert verdicts == ["kept" if number % 2 else "rejected", "rejected"]
    assert one.json(f"/datasets/{name}/stats") == two.json(f"/datasets/{name}/stats")


def test_a_run_that_one_carries_out_is_watched_and_cancelled_on_the_other(replicas):
    one, two = (each.api for each in replicas.both)
    name = create_slow_dataset(one, 20)

    accepted = one.post(f"/datasets/{name}/runs", {"config": FROM_PIXELS})
    run_id = accepted.json()["id"]
    with open_events(two, run_id) as stream:
        seen = list(stream)
    cut = one.post(
        f"/datasets/{name}/runs", {"config": {**FROM_PIXELS, "palette": scene.FAMILY}}
    )
    cancelled = two.post(f"/runs/{cut.json()['id']}/cancel")
    ended = two.wait_for_job(cut)

    assert seen[-1].name == "end"
    assert one.json(f"/runs/{run_id}")["state"] == "done"
    assert cancelled.status_code == 202
    assert ended["state"] == "cancelled"


def test_an_export_is_followed_on_any_server(replicas):
    one, two = replicas.one.api, replicas.two.api
    name = one.dataset()
    for number in range(3):
        one.upload_frame(name, f"f/{number}")

    asked = one.post(f"/datasets/{name}/exports", {"format": "coco"})
    seen = events(two, asked.json()["id"], of="exports")

    assert [event.name for event in seen][-1] == "end"
    assert seen[-1].data == one.json(f"/exports/{asked.json()['id']}")
    assert seen[-1].data["state"] == "done"


def test_a_null_character_is_a_client_error(replicas):
    answers = [
        replicas.one.api.get("/datasets/%00"),
        replicas.one.api.get("/boxes?dataset=%00"),
        replicas.one.api.post("/datasets/%00/queue", {}),
        replicas.one.api.put("%00", "a"),
    ]

    assert {answer.status_code for answer in answers} <= {404, 422}
