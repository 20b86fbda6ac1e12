"""Refused before any work is done: large bodies, other hosts, unknown parameters."""

from __future__ import annotations

import socket

import pytest

JSON_LIMIT = 5_000
LIMIT = 10_000
BATCH_LIMIT = 1_000_000


def pieces(total):
    for _ in range(total // 1000):
        yield b"x" * 1000


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(lambda: b"x" * (LIMIT + 1), id="announced by Content-Length"),
        pytest.param(lambda: pieces(LIMIT + 1000), id="in chunks of unknown number"),
    ],
)
def test_a_body_over_the_limit_is_413(admin, content):
    answer = admin.post("/probe/echo", content=content())

    assert (answer.status_code, answer.json()["code"]) == (413, "too_large")
    assert str(LIMIT) in answer.json()["detail"]


def test_a_body_at_the_limit_is_read(admin):
    assert admin.post("/probe/echo", content=b"x" * LIMIT).json() == LIMIT


def test_a_json_body_over_its_own_limit_is_413(admin):
    answer = admin.post("/probe/tokens", json={"name": "x" * JSON_LIMIT})

    assert (answer.status_code, answer.json()["code"]) == (413, "too_large")


def test_endless_chunked_body_is_refused_with_413(service):
    host, port = service.url.removeprefix("http://").split(":")
    head = (
        "POST /probe/echo HTTP/1.1\r\n"
        f"Host: {host}\r\nAuthorization: Bearer {service.token}\r\n"
        "Transfer-Encoding: chunked\r\n\r\n"
    )
    with socket.create_connection((host, int(port))) as connection:
        connection.sendall(head.encode())
        connection.sendall(b"3e8\r\n" + b"x" * 1000 + b"\r\n")
        for _ in range(LIMIT // 1000):
            connection.sendall(b"3e8\r\n" + b"x" * 1000 + b"\r\n")
        received = b"".join(iter(lambda: connection.recv(65536), b""))

    assert received.startswith(b"HTTP/1.1 413 ")
    assert b"connection: close" in received.lower()


def test_a_streaming_route_has_a_limit_of_its_own(admin):
    taken = admin.post("/probe/stream", content=pieces(BATCH_LIMIT))
    refused = admin.post("/probe/stream", content=pieces(BATCH_LIMIT + 1000))

    assert (taken.json(), refused.status_code) == (BATCH_LIMIT, 413)


def test_too_large_body_without_a_token_returns_401_not_413(anonymous):
    answer = anonymous.post("/probe/stream", content=pieces(BATCH_LIMIT * 2))

    assert answer.status_code == 401


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1.evil.example:80", "localhost.", "[::2]:8000"]
)
def test_unknown_host_returns_421(admin, host):
    answer = admin.get("/healthz", headers={"Host": host})

    assert (answer.status_code, answer.json()["code"]) == (421, "misdirected_host")


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:9", "127.0.0.1:8000", "[::1]:8000"]
)
def test_loopback_host_is_served(admin, host):
    assert admin.get("/healthz", headers={"Host": host}).status_code == 200


def test_allowed_host_is_served(serve):
    service = serve(allowed_hosts=("boxes.example",))

    with service.client(Host="boxes.example") as client:
        assert client.get("/healthz").status_code == 200


def test_wildcard_allows_any_host(serve):
    service = serve(allowed_hosts=("*",))

    with service.client(Host="anything.example") as client:
        assert client.get("/healthz").status_code == 200


@pytest.mark.parametrize(
    "path", ["/healthz?a=1", "/version?limit=1", "/open/hello?x", "/probe/items/1?b=2"]
)
def test_an_unknown_query_parameter_is_400_and_is_named(admin, path):
    if path.endswith("?x"):
        path += "="

    problem = admin.get(path).json()

    assert (problem["status"], problem["code"]) == (400, "unknown_parameter")
    assert repr(path.partition("?")[2].partition("=")[0]) in problem["detail"]


def test_known_query_parameter_is_accepted(admin):
    assert admin.get("/probe/items/1?limit=5").json() == {"item_id": 1, "limit": 5}
