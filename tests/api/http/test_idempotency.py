"""A POST with an Idempotency-Key is done once, however often it is sent."""

from concurrent.futures import ThreadPoolExecutor

import pytest


def post_token(client, name, key):
    return client.post(
        "/probe/tokens", json={"name": name}, headers={"Idempotency-Key": key}
    )


def test_repeated_idempotency_key_replays_the_response_even_after_a_restart(serve):
    responses = []
    for _ in range(2):
        with serve().admin() as client:
            responses += [post_token(client, "ada", "k1") for _ in range(2)]

    first, *others = responses
    assert [response.status_code for response in responses] == [201] * 4
    assert [response.json() for response in responses] == [{"stored": "ada"}] * 4
    assert "idempotent-replayed" not in first.headers
    for again in others:
        assert again.headers["idempotent-replayed"] == "true"
        assert again.headers["content-type"] == "application/json"


def test_repeated_request_without_idempotency_key_is_processed_again(admin):
    first = admin.post("/probe/tokens", json={"name": "bob"})
    again = admin.post("/probe/tokens", json={"name": "bob"})

    # The database refuses the row only at the commit.
    assert (first.status_code, again.status_code) == (201, 409)
    assert again.json()["code"] == "conflict"


def test_idempotency_key_reused_with_another_body_or_path_is_refused(admin):
    post_token(admin, "eve", "k2")

    for path, body in (
        ("/probe/tokens", {"name": "x"}),
        ("/probe/tokens", {"name": "eve", "count": 1}),
        ("/probe/tokens/copies", {"name": "eve"}),
    ):
        response = admin.post(path, json=body, headers={"Idempotency-Key": "k2"})
        refusal = (response.status_code, response.json()["code"])
        assert refusal == (422, "idempotency_key_reuse"), (path, body)


def test_idempotency_key_is_scoped_to_its_token(admin, as_role):
    post_token(admin, "lea", "k4")

    response = post_token(as_role("reviewer"), "max", "k4")

    assert response.json() == {"stored": "max"}


def test_concurrent_requests_with_one_idempotency_key_are_processed_once(
    service, admin
):
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
        responses = list(pool.map(post, range(2)))

    assert [response.status_code for response in responses] == [201, 201]
    assert responses[0].json() == responses[1].json()
    assert admin.get("/probe/tokens/count").json() == responses[0].json()["tokens"]


def test_idempotency_key_of_a_failed_request_may_be_reused(admin):
    post_token(admin, "ned", "k6")
    refused = post_token(admin, "ned", "k7")

    retried = post_token(admin, "nina", "k7")

    assert (refused.status_code, retried.status_code) == (409, 201)


@pytest.mark.parametrize("key", ["", "a b", "x" * 201, "ä"])
def test_invalid_idempotency_key_is_refused(admin, key):
    headers = [(b"Idempotency-Key", key.encode("latin-1"))]

    response = admin.post("/probe/tokens", json={"name": "otto"}, headers=headers)

    assert response.json()["code"] == "bad_idempotency_key"
