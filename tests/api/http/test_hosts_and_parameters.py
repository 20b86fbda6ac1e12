"""Requests to another host and with unknown parameters are refused."""

from __future__ import annotations

import pytest


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


def test_query_parameter_that_is_given_twice_is_refused(admin):
    problem = admin.get("/probe/items/1?limit=5&limit=6").json()

    assert (problem["status"], problem["code"]) == (400, "repeated_parameter")
    assert problem["detail"] == "query parameter 'limit': expected once, found 2 values"


def test_known_query_parameter_is_accepted(admin):
    assert admin.get("/probe/items/1?limit=5").json() == {"item_id": 1, "limit": 5}
