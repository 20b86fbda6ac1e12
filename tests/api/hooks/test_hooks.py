"""Hooks: signed, tried again, continued after a restart, and only to allowed hosts."""

import time
from functools import partial
from typing import Any

import pytest

from app.hooks.delivery import ANSWER_WITHIN_S
from tests.support import frames as scene
from tests.support.api import BY_TAGS, Api
from tests.support.documents import blocks, read
from tests.support.live import live
from tests.support.receiver import receiving
from tests.support.servers import running_server
from tests.support.waiting import until

(VERIFIER,) = blocks(read("docs/api.md"), "python")
HOSTS = {"hook_hosts": ("127.0.0.1",)}


@pytest.fixture
def receiver():
    with receiving() as hook_receiver:
        yield hook_receiver


def log_of(api, hook):
    return api.json(f"/hooks/{hook['id']}/deliveries")["items"]


def settled(api, hook, number):
    """The log of a hook, newest first, once so many deliveries are over."""

    def over():
        log = log_of(api, hook)
        is_over = len(log) >= number and not any(delivery["due_at"] for delivery in log)
        return log if is_over else None

    return until(over)


def test_ends_of_jobs_and_of_a_review_are_sent_and_signed(own_api, receiver):
    dataset = own_api.dataset(config=BY_TAGS)
    car = {"class": "car", "xyxy": scene.ON_THE_CAR}
    boxes = [{**car, "distance": 10}, {**car, "distance": 20}]
    own_api.upload_frame(dataset, "a", {**scene.annotation(), "boxes": boxes})
    hook = own_api.post("/hooks", {"url": receiver.url, "dataset": dataset}).json()

    own_api.run(dataset, {**BY_TAGS, "min_visible_pixels": 3})
    export = own_api.wait_for_job(
        own_api.post(f"/datasets/{dataset}/exports", {"format": "yolo", "name": "v1"})
    )
    receiver.wait_for(2)
    for box in own_api.boxes(dataset):
        own_api.review(box["box_id"], "keep", 0)
    requests = receiver.wait_for(3)

    assert all(request.is_signed_with(hook["secret"]) for request in requests)
    shown: dict[str, Any] = {}
    exec(VERIFIER, shown)
    is_genuine = partial(shown["is_genuine"], hook["secret"])
    assert all(is_genuine(request.headers, request.body) for request in requests)
    assert not is_genuine(requests[0].headers, requests[0].body + b" ")
    types = [request.content["type"] for request in requests]
    assert types == ["run.ended", "export.ended", "dataset.reviewed"]
    assert requests[1].content["data"] == {
        "dataset": dataset,
        "export": export["id"],
        "version": export["version"],
        "state": "done",
        "error": None,
        "format": "yolo",
        "name": "v1",
        "url": f"/api/v1/exports/{export['id']}",
    }
    log = settled(own_api, hook, 3)
    assert [delivery["state"] for delivery in log] == ["delivered"] * 3
    assert [delivery["webhook_id"] for delivery in log] == [
        request.headers["webhook-id"] for request in reversed(requests)
    ]
    assert hook["secret"] not in own_api.get("/hooks").text

    receiver.statuses = [302]
    own_api.post(f"/hooks/{hook['id']}/ping")
    receiver.wait_for(4)
    until(lambda: log_of(own_api, hook)[0]["attempts"])
    redirected, *_ = log_of(own_api, hook)
    own_api.delete(f"/hooks/{hook['id']}")
    assert len(receiver.received) == 4
    assert redirected["error"].endswith("302, and redirects are not followed")


def test_refused_delivery_is_tried_again_after_a_restart(tmp_path, receiver):
    receiver.statuses = [500]
    with live(tmp_path / "data", **HOSTS) as first, first.admin() as client:
        api = Api(client)
        hook = api.post("/hooks", {"url": receiver.url}).json()
        api.post(f"/hooks/{hook['id']}/ping")
        receiver.wait_for(1)
        until(lambda: log_of(api, hook)[0]["attempts"])
        (waiting,) = log_of(api, hook)

    with live(tmp_path / "data", **HOSTS) as second, second.admin() as client:
        earlier, later = receiver.wait_for(2)
        (over,) = settled(Api(client), hook, 1)

    assert (waiting["state"], waiting["status"]) == ("waiting", 500)
    assert waiting["error"] == "the receiver responded with 500"
    assert (over["state"], over["attempts"], over["error"]) == ("delivered", 2, None)
    assert earlier.headers["webhook-id"] == later.headers["webhook-id"]
    assert earlier.body == later.body == over["body"].encode()
    assert later.is_signed_with(hook["secret"])


def test_stop_does_not_wait_for_a_receiver(tmp_path, receiver):
    receiver.may_respond.clear()
    with live(tmp_path / "data", **HOSTS) as first, first.admin() as client:
        hook = Api(client).post("/hooks", {"url": receiver.url}).json()
        Api(client).post(f"/hooks/{hook['id']}/ping")
        receiver.wait_for(1)
        stopped_at = time.monotonic()
    took_s = time.monotonic() - stopped_at
    receiver.may_respond.set()

    with live(tmp_path / "data", **HOSTS) as second, second.admin() as client:
        (over,) = settled(Api(client), hook, 1)

    assert took_s < ANSWER_WITHIN_S / 2
    assert (over["state"], over["attempts"]) == ("delivered", 1)


def test_delivery_that_a_killed_service_had_begun_is_made_again(tmp_path, receiver):
    data = tmp_path / "data"
    settings = {"UNGHOST_HOOK_HOSTS": "127.0.0.1"}
    receiver.may_respond.clear()
    with running_server(data, settings) as first:
        with (api := Api.at(first.url, first.headers)).http:
            hook = api.post("/hooks", {"url": receiver.url}).json()
            api.post(f"/hooks/{hook['id']}/ping")
            receiver.wait_for(1)
        first.process.kill()
        first.process.wait()
    receiver.may_respond.set()

    with (
        running_server(data, settings) as second,
        (api := Api.at(second.url, second.headers)).http,
    ):
        earlier, later = receiver.wait_for(2)
        (over,) = settled(api, hook, 1)

    assert earlier.headers["webhook-id"] == later.headers["webhook-id"]
    assert earlier.body == later.body
    assert later.is_signed_with(hook["secret"])
    assert (over["state"], over["attempts"]) == ("delivered", 1)
    assert len(receiver.received) == 2


def test_host_that_is_not_listed_is_refused_with_the_remedy(own_api):
    for host in ("10.0.0.7", "127.0.0.2", "2130706433", "[::1]"):
        for scheme in ("http", "https"):
            response = own_api.post("/hooks", {"url": f"{scheme}://{host}/"})
            assert (response.status_code, response.json()["code"]) == (422, "hook_host")
            assert response.json()["detail"] == (
                f"this server sends nothing to {host}: its admin has to start it with "
                f"{host} in UNGHOST_HOOK_HOSTS, which lists 127.0.0.1"
            )
    for url in ("ftp://127.0.0.1/", "127.0.0.1", "http://a:b@127.0.0.1/", "http://"):
        response = own_api.post("/hooks", {"url": url})
        assert response.json()["code"] == "unprocessable", url


def test_host_that_is_no_longer_listed_gets_nothing(tmp_path, receiver):
    with live(tmp_path / "data", **HOSTS) as first, first.admin() as client:
        hook = Api(client).post("/hooks", {"url": receiver.url}).json()

    with live(tmp_path / "data") as second, second.admin() as client:
        api = Api(client)
        api.post(f"/hooks/{hook['id']}/ping")
        until(lambda: log_of(api, hook)[0]["attempts"])
        (refused,) = log_of(api, hook)

    assert receiver.received == []
    assert "UNGHOST_HOOK_HOSTS, which lists none" in refused["error"]
