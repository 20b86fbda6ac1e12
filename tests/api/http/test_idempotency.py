"""A POST with an Idempotency-Key is done once, however often it is sent."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest


def add(client, name, key, **more):
    return client.post(
        "/probe/tokens", json={"name": name, **more}, headers={"Idempotency-Key": key}
    )


def test_the_same_request_again_gets_the_same_answer(admin):
    first, again = add(admin, "ada", "k1"), add(admin, "ada", "k1")

    assert first.status_code == again.status_code == 201
    assert first.json() == again.json() == {"stored": "ada"}
    assert "idempotent-replayed" not in first.headers
    assert again.headers["idempotent-replayed"] == "true"
    assert again.headers["content-type"] == "application/json"


def test_the_same_request_without_a_key_is_done_again(admin):
    first = admin.post("/probe/tokens", json={"name": "bob"})
    again = admin.post("/probe/tokens", json={"name": "bob"})

    assert (first.status_code, again.status_code) == (201, 409)


@pytest.mark.parametrize("change", [{"name": "x"}, {"count": 1}])
def test_another_request_with_the_same_key_is_refused(admin, change):
    key = f"k2-{list(change)}"
    add(admin, f"eve-{key}", key)

    answer = add(admin, **{"name": f"eve-{key}", "key": key, **change})

    assert (answer.status_code, answer.json()["code"]) == (422, "idempotency_key_reuse")


def test_another_path_with_the_same_key_is_refused(admin):
    add(admin, "kim", "k3")

    answer = admin.post(
        "/probe/tokens/copies", json={"name": "kim"}, headers={"Idempotency-Key": "k3"}
    )

    assert answer.json()["code"] == "idempotency_key_reuse"


def test_a_key_belongs_to_its_token(admin, as_role):
    add(admin, "lea", "k4")

    answer = add(as_role("reviewer"), "max", "k4")

    assert answer.json() == {"stored": "max"}


def test_two_at_the_same_time_are_done_once(service, admin):
    """Both requests pass every check before either of them writes."""

    def post(_):
        with service.admin() as client:
            return client.post(
                "/probe/slow",
                json={"name": "zoe"},
                headers={"Idempotency-Key": "k5"},
                timeout=60,
            )

    with ThreadPoolExecutor(2) as pool:
        answers = list(pool.map(post, range(2)))

    assert [answer.status_code for answer in answers] == [201, 201]
    assert answers[0].json() == answers[1].json()
    assert admin.get("/probe/tokens/count").json() == answers[0].json()["tokens"]


def test_a_request_that_failed_may_be_sent_again(admin):
    add(admin, "ned", "k6")
    refused = add(admin, "ned", "k7")

    retried = add(admin, "nina", "k7")

    assert (refused.status_code, retried.status_code) == (409, 201)


@pytest.mark.parametrize("key", ["", "a b", "x" * 201, "ä"])
def test_a_key_that_cannot_be_one_is_refused(admin, key):
    headers = [(b"Idempotency-Key", key.encode("latin-1"))]

    answer = admin.post("/probe/tokens", json={"name": "otto"}, headers=headers)

    assert answer.json()["code"] == "bad_idempotency_key"


def test_an_answer_is_kept_over_a_restart(serve):
    with serve().admin() as client:
        first = add(client, "pia", "k8")
    with serve().admin() as client:
        again = add(client, "pia", "k8")

    assert again.headers["idempotent-replayed"] == "true"
    assert again.json() == first.json()


def test_the_commit_comes_before_the_answer(admin):
    """A row that the database refuses at the commit is a 409 and not a 201."""
    admin.post("/probe/tokens", json={"name": "quinn"})

    answer = admin.post("/probe/tokens", json={"name": "quinn"})

    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
