"""The limit on open connections: idle ones are closed so that requests are served."""

from __future__ import annotations

import os
import socket
import sys
import threading
from contextlib import ExitStack, closing, contextmanager

import httpx
import pytest

from app.process.connections import (
    origin_of,
    raise_descriptor_limit,
    room_for_connections,
)
from tests.support import frames as scene
from tests.support import plain_http
from tests.support.live import live
from tests.support.servers import start_anew, stop, token_of, wait_for_link

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(os.name != "posix", reason="only POSIX counts descriptors"),
]

LONG_S = 60
STRANGERS = 3_000
STREET = "/api/v1/datasets/street"
BEGUN = {
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


def connected(url, source="127.0.0.1"):
    """An open connection on which nothing was sent."""
    at = httpx.URL(str(url))
    return closing(
        socket.create_connection(
            (at.host, at.port or 0), timeout=LONG_S, source_address=(source, 0)
        )
    )


def put(client, key):
    """Upload a frame on a connection of its own; return the status."""
    files = {
        "annotation": scene.as_json(scene.annotation()),
        "image": scene.image(),
        "segmentation": scene.segmentation(),
    }
    with client_of(client.base_url, client.headers) as once:
        return once.put(f"{STREET}/frames/{key}", files=files).status_code


def all_of(connection):
    """Everything received until the server closes the connection, or a time-out."""
    return b"".join(iter(lambda: connection.recv(65536), b""))


def test_uploads_go_on_while_thousands_of_idle_connections_are_tried(tmp_path):
    raise_descriptor_limit()
    answers: list[int] = []
    data = tmp_path / "data"
    with ExitStack() as held, limited_server(data, soft=1024, hard=1024) as (admin, _):
        admin.post("/api/v1/datasets", json={"name": "street"})

        def come():
            for _ in range(STRANGERS):
                held.enter_context(connected(admin.base_url))

        strangers = threading.Thread(target=come)
        strangers.start()
        while strangers.is_alive():
            answers.append(put(admin, f"a{len(answers)}"))
        answers += [put(admin, f"b{number}") for number in range(5)]
        seen = admin.get("/metrics").text

    assert len(answers) > 5
    assert set(answers) == {201}
    assert "unghost_connections_max 352" in seen
    assert "unghost_connections_refused_total 0" in seen


def test_the_soft_limit_is_raised_and_said(tmp_path):
    with limited_server(tmp_path / "data", soft=256, hard=2_000) as (admin, log):
        seen = admin.get("/metrics").text
        said = log.read_text("utf-8")

    assert "at most 2000 files and connections may be open, 840 of them" in said
    assert "unghost_connections_max 840" in seen


def test_without_any_descriptor_left_the_service_goes_on_later(tmp_path):
    full = limited_server(
        tmp_path / "data",
        soft=400,
        hard=400,
        taken=345,
        UNGHOST_MAX_CONNECTIONS_PER_ADDRESS="40",
    )
    with full as (admin, log):
        with ExitStack() as held:
            for _ in range(200):
                last = held.enter_context(connected(admin.base_url))
            assert all_of(last) == b""  # the server had no descriptor left to accept it
        again = put(admin, "a"), admin.post("/api/v1/datasets", json={"name": "b"})
        said = log.read_text("utf-8").splitlines()

    assert (again[0], again[1].status_code) == (404, 201)
    assert len(said) < 100


@pytest.mark.parametrize("begun", BEGUN.values(), ids=BEGUN)
def test_connections_without_a_token_make_room_for_others(tmp_path, begun):
    with live(tmp_path / "data", max_connections=4) as service, ExitStack() as held:
        for _ in range(12):
            stranger = held.enter_context(connected(service.url))
            stranger.sendall(begun)
        with service.admin() as admin:
            answer = admin.post("/api/v1/datasets", json={"name": "street"})
            seen = admin.get("/metrics").text

    assert answer.status_code == 201
    assert "unghost_connections_refused_total 0" in seen


def at_work(service, held, source="127.0.0.1"):
    """A connection with an authenticated request whose body is not yet sent."""
    lines = (
        "POST /api/v1/datasets HTTP/1.1",
        "Host: localhost",
        f"Authorization: Bearer {service.token}",
        "Content-Type: application/json",
        "Content-Length: 17",
        "Expect: 100-continue",
    )
    connection = held.enter_context(connected(service.url, source))
    connection.sendall("\r\n".join((*lines, "", "")).encode())
    assert connection.recv(100).startswith(b"HTTP/1.1 100 Continue")
    return connection


def asked(service, source="127.0.0.1"):
    """The answer to a health check on a new connection."""
    with connected(service.url, source) as connection:
        connection.sendall(
            b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
        )
        return all_of(connection)


def test_a_service_at_its_limit_of_connections_says_when_to_come_again(tmp_path):
    settings = {"max_connections": 2, "max_connections_per_address": 2}
    with live(tmp_path / "data", **settings) as service, ExitStack() as held:
        first, second = at_work(service, held), at_work(service, held)
        turned_away = asked(service)
        first.sendall(b'{"name":"street"}')
        created = first.recv(65536)
        let_in = asked(service)
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


@pytest.mark.skipif(sys.platform != "linux", reason="others have one loopback address")
def test_one_address_leaves_room_for_others(tmp_path):
    settings = {"max_connections": 10, "max_connections_per_address": 2}
    with live(tmp_path / "data", **settings) as service, ExitStack() as held:
        at_work(service, held), at_work(service, held)
        same = asked(service)
        other = asked(service, "127.0.0.2")

    assert same.startswith(b"HTTP/1.1 503 ")
    assert b"all 2 connections for one address" in same
    assert other.startswith(b"HTTP/1.1 200 ")


def test_people_behind_a_trusted_proxy_do_not_count_as_one_address(tmp_path):
    settings = {"max_connections_per_address": 2, "trusted_proxies": ("127.0.0.0/8",)}
    with live(tmp_path / "data", **settings) as service, ExitStack() as held:
        for _ in range(5):
            at_work(service, held)
        answer = asked(service)

    assert answer.startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize(
    ("limit", "room"), [(None, 2048), (256, 16), (1024, 352), (4416, 2048)]
)
def test_each_connection_finds_a_descriptor_for_its_file_as_well(limit, room):
    assert room_for_connections(limit) == room


@pytest.mark.parametrize(
    ("address", "place"),
    [
        ("192.0.2.1", "192.0.2.1"),
        ("::ffff:192.0.2.1", "192.0.2.1"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2::9", "2001:db8:1:2::/64"),
        ("::1", "::/64"),
        ("unix socket", "unix socket"),
        (None, "-"),
    ],
)
def test_one_network_counts_as_one_address(address, place):
    assert origin_of(address) == place
