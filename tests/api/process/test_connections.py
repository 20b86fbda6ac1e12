"""The limit on open connections: idle ones are closed so that requests are served."""

import os
import sys
import threading
from contextlib import ExitStack, contextmanager

import pytest

from app.process.connections import raise_descriptor_limit, room_for_connections
from tests.support import plain_http
from tests.support.api import Api
from tests.support.connections import open_connection, read_until_closed, request_head
from tests.support.live import live
from tests.support.servers import start_anew, stop, token_of, wait_for_link

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(os.name != "posix", reason="only POSIX counts descriptors"),
]

LONG_S = 60
IDLE_CONNECTIONS = 3_000
UNFINISHED_REQUESTS = {
    "nothing": b"",
    "half a head": b"GET /healthz HTTP/1.1\r\nHost: loc",
    "half a body": b"POST /api/v1/session HTTP/1.1\r\nHost: localhost\r\n"
    b"Content-Type: application/json\r\nContent-Length: 100\r\n\r\n{",
    "a request": b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
}
WITH_LIMITS = """
import os, resource, sys
soft, hard, taken = map(int, sys.argv[1:])
resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
for _ in range(taken):
    os.set_inheritable(os.open(os.devnull, os.O_RDONLY), True)
os.execv(sys.executable, [sys.executable, "-m", "app"])
"""


@contextmanager
def limited_server(data, *, soft, hard, taken=0, **settings):
    """A server that may open only so many files, `taken` of which are already open.

    Yields an admin's client and the path of the server's log.
    """
    log = data.with_name("server.log")
    command = [sys.executable, "-c", WITH_LIMITS, *map(str, (soft, hard, taken))]
    settings = {"UNGHOST_LOG_FORMAT": "text", **settings}
    process = start_anew(command, data, log, settings)
    try:
        url = wait_for_link(process, log).partition("/#")[0]
        bearer = {"Authorization": f"Bearer {token_of(data)}"}
        with client_of(url, bearer) as client:
            yield client, log
    finally:
        stop(process)


def client_of(url, headers):
    return plain_http.Client(base_url=url, headers=headers, timeout=LONG_S)


def put(client, key):
    """Upload a frame on a connection of its own; return the status."""
    with client_of(client.base_url, client.headers) as once:
        return Api(once).put("street", key).status_code


def test_uploads_succeed_while_thousands_of_idle_connections_are_opened(tmp_path):
    raise_descriptor_limit()
    statuses: list[int] = []
    data = tmp_path / "data"
    with ExitStack() as held, limited_server(data, soft=1024, hard=1024) as (admin, _):
        admin.post("/api/v1/datasets", json={"name": "street"})

        def open_idle_connections():
            for _ in range(IDLE_CONNECTIONS):
                held.enter_context(open_connection(str(admin.base_url)))

        opening = threading.Thread(target=open_idle_connections)
        opening.start()
        while opening.is_alive():
            statuses.append(put(admin, f"a{len(statuses)}"))
        statuses += [put(admin, f"b{number}") for number in range(5)]
        seen = admin.get("/metrics").text

    assert len(statuses) > 5
    assert set(statuses) == {201}
    assert "unghost_connections_max 352" in seen
    assert "unghost_connections_refused_total 0" in seen


def test_soft_descriptor_limit_is_raised_and_logged(tmp_path):
    with limited_server(tmp_path / "data", soft=256, hard=2_000) as (admin, log):
        seen = admin.get("/metrics").text
        said = log.read_text("utf-8")

    assert "at most 2000 files and connections may be open, 840 of them" in said
    assert "unghost_connections_max 840" in seen


def test_service_recovers_after_running_out_of_descriptors(tmp_path):
    full = limited_server(
        tmp_path / "data", soft=400, hard=400, taken=345, UNGHOST_MAX_CONNECTIONS="40"
    )
    with full as (admin, log):
        with ExitStack() as held:
            for _ in range(200):
                last = held.enter_context(open_connection(str(admin.base_url)))
            # The server had no descriptor left to accept it.
            assert read_until_closed(last) == b""
        again = put(admin, "a"), admin.post("/api/v1/datasets", json={"name": "b"})
        said = log.read_text("utf-8").splitlines()

    assert (again[0], again[1].status_code) == (404, 201)
    assert len(said) < 100


@pytest.mark.parametrize("begun", UNFINISHED_REQUESTS.values(), ids=UNFINISHED_REQUESTS)
def test_unauthenticated_connections_are_closed_for_new_ones(tmp_path, begun):
    with live(tmp_path / "data", max_connections=4) as service, ExitStack() as held:
        for _ in range(12):
            connection = held.enter_context(open_connection(service.url))
            connection.sendall(begun)
        with service.admin() as admin:
            response = admin.post("/api/v1/datasets", json={"name": "street"})
            seen = admin.get("/metrics").text

    assert response.status_code == 201
    assert "unghost_connections_refused_total 0" in seen


def open_busy_connection(service, held):
    """A connection with an authenticated request whose body is not yet sent."""
    headers = {
        **service.bearer,
        "Content-Type": "application/json",
        "Content-Length": "17",
        "Expect": "100-continue",
    }
    connection = held.enter_context(open_connection(service.url))
    connection.sendall(request_head("POST", "/api/v1/datasets", headers))
    assert connection.recv(100).startswith(b"HTTP/1.1 100 Continue")
    return connection


def health_response(service):
    """The answer to a health check on a new connection."""
    with open_connection(service.url) as connection:
        connection.sendall(request_head("GET", "/healthz", {"Connection": "close"}))
        return read_until_closed(connection)


def test_connection_over_the_limit_returns_503_with_retry_after(tmp_path):
    with live(tmp_path / "data", max_connections=2) as service, ExitStack() as held:
        first, second = (
            open_busy_connection(service, held),
            open_busy_connection(service, held),
        )
        turned_away = health_response(service)
        first.sendall(b'{"name":"street"}')
        created = first.recv(65536)
        let_in = health_response(service)
        second.sendall(b'{"name":"avenue"}')
        undisturbed = second.recv(65536)

    head, _, body = turned_away.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 503 Service Unavailable\r\n")
    assert b"content-type: application/problem+json" in head
    assert b"retry-after: 5" in head
    assert b"connection: close" in head
    assert b'"code":"too_many_connections"' in body
    assert created.startswith(b"HTTP/1.1 201 ")
    assert let_in.startswith(b"HTTP/1.1 200 ")
    assert undisturbed.startswith(b"HTTP/1.1 201 ")


@pytest.mark.parametrize(
    ("limit", "room"), [(None, 2048), (256, 16), (1024, 352), (4416, 2048)]
)
def test_room_for_connections_leaves_descriptors_for_files(limit, room):
    assert room_for_connections(limit) == room
