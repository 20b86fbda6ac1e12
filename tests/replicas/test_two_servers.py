"""Two servers that share one database behave together as one server does."""

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial

from app.access.gate import REMEMBERED_S
from app.hooks.delivery import EVERY_S
from tests.support import frames as scene
from tests.support import plain_http
from tests.support.api import BASE, Api
from tests.support.databases import empty_postgres
from tests.support.event_reader import events, open_events
from tests.support.receiver import receiving
from tests.support.servers import start, stop, token_of, wait_for_link
from tests.support.slow_datasets import FROM_PIXELS, OTHER_PIXELS, create_slow_dataset
from tests.support.waiting import until


def call_concurrently(first, second):
    """Call two functions at the same time, and give both results."""
    with ThreadPoolExecutor(2) as pool:
        futures = [pool.submit(first), pool.submit(second)]
        return [future.result() for future in futures]


def wait_until_unauthorised(client, path="/api/v1/datasets"):
    """Ask until the answer is 401; give when the last accepted request was sent.

    In seconds from the beginning. The time of sending counts and not that of the
    answer, which may be late on a busy machine.
    """
    begun, sent_s = time.monotonic(), [0.0]

    def is_refused():
        sent_s.append(time.monotonic() - begun)
        return client.get(path).status_code == 401

    until(is_refused, "it is never refused")
    return sent_s[-2]


def test_null_character_in_a_name_is_a_client_error(replicas):
    responses = [
        replicas.first.api.get("/datasets/%00"),
        replicas.first.api.get("/boxes?dataset=%00"),
        replicas.first.api.post("/datasets/%00/queue", {}),
        replicas.first.api.put("%00", "a"),
    ]

    assert {response.status_code for response in responses} <= {404, 422}


def test_servers_started_together_on_an_empty_database_use_one_token(tmp_path):
    data, logs = tmp_path / "data", [tmp_path / "log0", tmp_path / "log1"]
    with empty_postgres() as url, ExitStack() as running:
        processes = []
        for log in logs:
            process = start(["app"], data, log, {"UNGHOST_DATABASE_URL": url})
            running.callback(stop, process)
            processes.append(process)
        tokens = []
        for process, log in zip(processes, logs, strict=True):
            wait_for_link(process, log)
            tokens.append(token_of(data))

    assert tokens[0] == tokens[1]
    assert [process.wait() for process in processes] == [0, 0]


def test_login_code_and_session_of_one_server_are_valid_on_the_other(replicas):
    first, second = replicas.first.server.url, replicas.second.server.url
    assert replicas.first.server.token == replicas.second.server.token
    code = replicas.second.server.login_link.partition("/#code=")[2]
    opened = plain_http.post(f"{first}/api/v1/session", json={"code": code})
    again = plain_http.post(f"{second}/api/v1/session", json={"code": code})
    shown = {"Authorization": f"Bearer {opened.json()['session']}"}
    with plain_http.Client(base_url=second, headers=shown) as browser:
        session = browser.get("/api/v1/session")
        browser.delete("/api/v1/session")
    with plain_http.Client(base_url=first, headers=shown) as browser:
        last_sent_s = wait_until_unauthorised(browser)

    assert (opened.status_code, again.status_code) == (201, 401)
    assert session.json()["name"] == "admin"
    assert last_sent_s < REMEMBERED_S


def test_revoked_token_is_unauthorised_on_both_servers_within_a_second(replicas):
    made = replicas.first.api.post("/tokens", {"name": "eve", "role": "viewer"}).json()
    headers = {"Authorization": f"Bearer {made['token']}"}
    with (
        Api.at(replicas.first.server.url, headers).http as first,
        Api.at(replicas.second.server.url, headers).http as second,
    ):
        assert first.get("/version").status_code == 200
        assert second.get("/version").status_code == 200

        revoked = replicas.first.api.http.delete(f"{BASE}/tokens/{made['id']}")
        here = first.get("/version").status_code
        last_sent_s = wait_until_unauthorised(second)

    assert (revoked.status_code, here) == (204, 401)
    assert last_sent_s < REMEMBERED_S


def test_of_two_concurrent_reviews_of_a_box_one_is_stale(replicas, make_reviewer):
    (ada, _), (_, bob) = make_reviewer(), make_reviewer()
    name = replicas.make_dataset(frames=6)
    boxes = ada.box_ids(name)

    for box_id in boxes:
        responses = call_concurrently(
            partial(ada.review, box_id, "keep"), partial(bob.review, box_id, "reject")
        )
        by_status = {response.status_code: response.json() for response in responses}
        assert by_status.keys() == {201, 412}
        shown = [each.api.json(f"/boxes/{box_id}") for each in replicas.both]
        assert shown[0] == shown[1]
        assert shown[0]["review"]["verdict"] == by_status[201]["verdict"]
        assert by_status[412]["current"]["review"]["revision"] == 1
    counts = [each.api.json(f"/datasets/{name}/stats") for each in replicas.both]
    assert counts[0] == counts[1]


def answer_in_bulk_at_once(ada, bob, act, which):
    """Two bulk answers on the same boxes. Nobody repeats one: that would be none."""
    verdicts = ("keep", "reject") if act % 2 else ("reject", "keep")
    return call_concurrently(
        *(
            partial(who.post, "/reviews/bulk", {"verdict": verdict, **which})
            for who, verdict in zip((ada, bob), verdicts, strict=True)
        )
    )


def test_of_two_concurrent_bulk_answers_each_box_counts_in_one(replicas, make_reviewer):
    (ada, _), (_, bob) = make_reviewer(), make_reviewer()
    name = replicas.make_dataset(frames=5)
    boxes = ada.box_ids(name)

    for act in range(10):
        seen = [act] * len(boxes)
        which = {"dataset": name, "box_ids": boxes, "seen_revisions": seen}
        responses = answer_in_bulk_at_once(ada, bob, act, which)
        assert [response.status_code for response in responses] == [201, 201]
        done = sorted(
            (each.json() for each in responses), key=lambda batch: batch["count"]
        )
        assert [batch["count"] for batch in done] == [0, len(boxes)]
        assert [batch["stale"] for batch in done] == [boxes, []]
        won = done[1]["verdict"]
        shown = [each.api.boxes(name) for each in replicas.both]
        assert shown[0] == shown[1]
        said = [(box["revision"], box["review"]["verdict"]) for box in shown[0]]
        assert said == [(act + 1, won)] * len(boxes)
        stats = replicas.first.api.json(f"/datasets/{name}/stats")
        assert (stats["reviewed"], stats["boxes"]) == (len(boxes), len(boxes))


def test_of_two_concurrent_bulk_answers_by_filter_the_later_is_stale(
    replicas, make_reviewer
):
    (ada, _), (_, bob) = make_reviewer(), make_reviewer()
    name = replicas.make_dataset(frames=5)

    for act in range(5):
        page = ada.json("/boxes", dataset=name, count="true")
        which = {"dataset": name, "filter": {}, "snapshot": page["snapshot"]}
        responses = answer_in_bulk_at_once(ada, bob, act, which)
        by_status = {response.status_code: response.json() for response in responses}
        assert by_status.keys() == {201, 412}
        late = by_status[412]
        assert late["code"] == "stale_snapshot"
        assert late["current"]["total"] == page["total"]


def test_idempotency_key_sent_to_both_servers_is_stored_once(replicas, make_reviewer):
    first, second = make_reviewer()
    name = replicas.make_dataset()
    box = first.boxes(name)[0]["box_id"]

    def post_review_with_key(api, number):
        path = f"{BASE}/boxes/{box}/reviews"
        body = {"verdict": ("keep", "reject")[number % 2], "seen_revision": number}
        headers = {"Idempotency-Key": f"{name}-{number}"}
        return api.http.post(path, json=body, headers=headers)

    for number in range(10):
        stored, repeated = call_concurrently(
            partial(post_review_with_key, first, number),
            partial(post_review_with_key, second, number),
        )
        assert (stored.status_code, repeated.status_code) == (201, 201), number
        assert stored.content == repeated.content
        replayed = [
            each.headers.get("Idempotent-Replayed") for each in (stored, repeated)
        ]
        assert replayed.count("true") == 1
    assert first.json(f"/boxes/{box}")["review"]["revision"] == 10


def test_queue_returns_no_box_to_two_people(replicas, make_reviewer):
    name = replicas.make_dataset(frames=20)
    clients = [make_reviewer()[number % 2] for number in range(6)]

    def take_from_queue(number: int) -> list[int]:
        taken: list[int] = []
        for order in ("doubt", "random", "class"):
            filters = {"review": "undecided"}  # in doubt or not
            body = {"limit": 2, "order": order, "exclude": taken, "filters": filters}
            response = clients[number].post(f"/datasets/{name}/queue", body)
            assert response.status_code == 200, response.text
            taken += [item["box_id"] for item in response.json()["items"]]
        return taken

    with ThreadPoolExecutor(6) as pool:
        parts = list(pool.map(take_from_queue, range(6)))

    assert [len(part) for part in parts] == [6] * 6
    assert len({box for part in parts for box in part}) == 36


def test_bulk_answer_of_one_server_is_undone_once_on_either(replicas, make_reviewer):
    first, second = make_reviewer()
    name = replicas.make_dataset(frames=4)
    ids = first.box_ids(name)
    body = {"dataset": name, "box_ids": ids, "verdict": "reject"}

    batch = first.post("/reviews/bulk", body).json()
    seen = second.json(f"/datasets/{name}/stats")["effective"]["rejected"]
    undone = call_concurrently(
        lambda: first.post(f"/review-batches/{batch['id']}/undo"),
        lambda: second.post(f"/review-batches/{batch['id']}/undo"),
    )

    assert (batch["count"], seen) == (8, 8)
    assert sorted(response.status_code for response in undone) == [200, 409]
    assert first.json(f"/datasets/{name}/stats")["effective"]["rejected"] == 4


def test_preview_cache_of_one_server_follows_writes_of_the_other(replicas):
    first, second = (each.api for each in replicas.both)
    name = replicas.make_dataset(frames=2)
    preview = {"config": {"min_visible_pixels": 10**6}}

    def flips(api):
        response = api.post(f"/datasets/{name}/preview", preview)
        assert response.status_code == 200, response.text
        return response.json()["flips"]["total"]

    before = flips(first), flips(second)
    first.upload_frame(name, "more", {**scene.annotation(), "number": 77})
    added = flips(first), flips(second)
    second.http.delete(f"{BASE}/datasets/{name}/frames/000")
    removed = flips(first), flips(second)
    second.upload_frame(
        name, "more", {**scene.annotation(), "number": 78}, replace=True
    )
    replaced = flips(first), flips(second)
    ran = first.run(name, {"min_visible_pixels": 10**6})
    decided = flips(first), flips(second)

    assert (before, added, removed, replaced) == ((2, 2), (3, 3), (2, 2), (2, 2))
    assert (ran["changed"], decided) == (2, (0, 0))
    second.upload_frame(name, "last", {**scene.annotation(), "number": 79})
    assert second.json(f"/datasets/{name}/stats")["kept"] == 0


def test_config_activated_on_one_server_decides_frames_on_the_other(replicas):
    first, second = (each.api for each in replicas.both)
    name = replicas.make_dataset(frames=2)

    for number in range(4):
        config = {} if number % 2 else {"min_visible_pixels": 10**6}
        replicas.both[number % 2].api.run(name, config)
        stored = replicas.both[1 - number % 2].api.upload_frame(
            name, f"after-{number}", {**scene.annotation(), "number": 100 + number}
        )
        verdicts = [decision["verdict"] for decision in stored["decisions"]]
        assert verdicts == ["kept" if number % 2 else "rejected", "rejected"]
    assert first.json(f"/datasets/{name}/stats") == second.json(
        f"/datasets/{name}/stats"
    )


def test_run_of_one_server_is_followed_and_cancelled_on_the_other(replicas):
    first, second = (each.api for each in replicas.both)
    name = create_slow_dataset(first, 20)

    accepted = first.post(f"/datasets/{name}/runs", {"config": FROM_PIXELS})
    run_id = accepted.json()["id"]
    with open_events(second, run_id) as stream:
        seen = list(stream)
    for config in OTHER_PIXELS:
        cut = first.post(f"/datasets/{name}/runs", {"config": config})
        cancelled = second.post(f"/runs/{cut.json()['id']}/cancel")
        if cancelled.status_code == 202:  # otherwise it was over before
            break
    ended = second.wait_for_job(cut)

    assert seen[-1].name == "end"
    assert first.json(f"/runs/{run_id}")["state"] == "done"
    assert cancelled.status_code == 202
    assert ended["state"] == "cancelled"


def test_export_events_of_one_server_are_read_on_the_other(replicas):
    first, second = replicas.first.api, replicas.second.api
    name = first.dataset()
    for number in range(3):
        first.upload_frame(name, f"f/{number}")

    export = first.post(f"/datasets/{name}/exports", {"format": "coco"})
    seen = events(second, export.json()["id"], of="exports")

    assert [event.name for event in seen][-1] == "end"
    assert seen[-1].data == first.json(f"/exports/{export.json()['id']}")
    assert seen[-1].data["state"] == "done"


def test_each_event_is_delivered_once_by_one_of_two_servers(replicas):
    first, second = (each.api for each in replicas.both)
    with receiving() as receiver:
        hook = first.post("/hooks", {"url": receiver.url}).json()
        for number in range(6):
            (first, second)[number % 2].post(f"/hooks/{hook['id']}/ping")
        receiver.wait_for(6)
        log = f"/hooks/{hook['id']}/deliveries"
        until(lambda: not any(entry["due_at"] for entry in second.json(log)["items"]))
        time.sleep(2 * EVERY_S)
        delivered = [request.headers["webhook-id"] for request in receiver.received]
    second.delete(f"/hooks/{hook['id']}")

    assert len(delivered) == len(set(delivered)) == 6
