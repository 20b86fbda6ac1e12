"""Requests to another host and with unknown parameters are refused."""

import sys
from urllib.parse import urlsplit

import pytest

from tests.support import plain_http
from tests.support.connections import open_connection, read_until_closed

HOSTS = {
    **dict.fromkeys(("evil.example", "localhost.", "[::2]:8000"), 421),
    **dict.fromkeys(("127.0.0.1.evil.example:80", "boxes.example"), 421),
    **dict.fromkeys(("localhost", "LOCALHOST:9", "127.0.0.1:8000", "[::1]:8000"), 200),
}


def test_only_a_loopback_host_or_an_allowed_one_is_served(admin, serve):
    for host, status in HOSTS.items():
        response = admin.get("/version", headers={"Host": host})
        assert response.status_code == status, host
        assert status == 200 or response.json()["code"] == "misdirected_host"

    for allowed in ("boxes.example", "*"):
        service = serve(allowed_hosts=(allowed,))
        with service.client(Host="boxes.example", **service.bearer) as client:
            assert client.get("/version").status_code == 200


@pytest.mark.parametrize("path", ["/healthz", "/readyz"])
@pytest.mark.parametrize("host", ["evil.example", "10.1.2.3:8000"])
def test_probe_is_served_under_any_name_and_without_one(anonymous, service, path, host):
    named = anonymous.get(path, headers={"Host": host})
    with open_connection(service.url) as connection:
        connection.sendall(f"GET {path} HTTP/1.0\r\n\r\n".encode())
        nameless = read_until_closed(connection)

    assert named.status_code == 200, named.text
    assert nameless.startswith(b"HTTP/1.1 200 ")


@pytest.mark.skipif(sys.platform != "linux", reason="others have one loopback address")
def test_of_literal_addresses_only_that_of_the_connection_is_known(start_server):
    server = start_server(UNGHOST_HOST="::")
    port = urlsplit(server.url).port

    def status(place, host):
        headers = {**server.headers, "Host": f"{host}:{port}"}
        url = f"http://{place}:{port}/version"
        return plain_http.get(url, headers=headers).status_code

    assert status("127.0.0.2", "127.0.0.2") == 200
    assert status("127.0.0.1", "127.0.0.2") == 421
    assert status("127.0.0.2", "127.0.0.3") == 421


@pytest.mark.parametrize(
    "path", ["/healthz?a=1", "/version?limit=1", "/open/hello?x", "/probe/items/1?b=2"]
)
def test_an_unknown_query_parameter_is_400_and_is_named(admin, path):
    if path.endswith("?x"):
        path += "="

    problem = admin.get(path).json()

    assert (problem["status"], problem["code"]) == (400, "unknown_parameter")
    assert repr(path.partition("?")[2].partition("=")[0]) in problem["detail"]


def test_known_query_parameter_is_accepted_once(admin):
    known, twice = map(
        admin.get, ("/probe/items/1?limit=5", "/probe/items/1?limit=5&limit=6")
    )

    assert known.json() == {"item_id": 1, "limit": 5}
    problem = twice.json()
    assert (problem["status"], problem["code"]) == (400, "repeated_parameter")
    assert problem["detail"] == "query parameter 'limit': expected once, found 2 values"
