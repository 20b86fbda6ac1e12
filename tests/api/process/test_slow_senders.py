"""Clients that stop in the middle of a request are answered 408 and disconnected."""

import select

import pytest

from app.process.server import MOST_PIPELINED
from tests.support.archives import frame, tar_without_end
from tests.support.connections import open_connection, read_until_closed, request_head
from tests.support.live import live

pytestmark = pytest.mark.long

TB = str(10**12)
SOON_S = 0.5
STREET = "/api/v1/datasets/street"


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slow") / "data"
    with live(folder, head_wait_s=SOON_S, body_wait_s=SOON_S) as running:
        with running.admin() as client:
            client.post("/api/v1/datasets", json={"name": "street"})
        yield running


def head(service, method, path, headers=None):
    """The head of an admin's request."""
    return request_head(method, path, service.bearer | (headers or {}))


def test_endless_request_head_is_cut_off(service):
    sent = 0
    with open_connection(service.url) as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Long: ")
        try:
            while sent < 100_000_000:
                connection.sendall(b"x" * 10_000)
                sent += 10_000
        except OSError:
            pass

    assert sent < 20_000_000  # most of it is in the buffers of the two sockets


def test_body_of_a_refused_request_is_not_read_endlessly(service):
    begin = request_head(
        "POST", "/api/v1/datasets", {"Authorization": "no", "Content-Length": TB}
    )
    sent = 0
    with open_connection(service.url) as connection:
        connection.sendall(begin)
        response = connection.recv(65536)
        try:
            while sent < 1_000_000_000:
                connection.sendall(b"x" * 1_000_000)
                sent += 1_000_000
        except OSError:
            pass

    assert response.startswith(b"HTTP/1.1 401 ")
    assert sent < 200_000_000


@pytest.mark.parametrize("begun", [b"GE", b"GET /healthz HTTP/1.1\r\nHost: loc"])
def test_incomplete_request_head_times_out_with_408(service, begun):
    with open_connection(service.url) as connection:
        connection.sendall(begun)
        response = read_until_closed(connection)

    assert response.startswith(b"HTTP/1.1 408 Request Timeout\r\n")
    assert b'"code":"request_timeout"' in response


def test_a_silent_connection_is_closed(service):
    with open_connection(service.url) as connection:
        assert read_until_closed(connection) == b""


def test_incomplete_second_request_times_out_with_408(service):
    first = head(service, "GET", "/healthz")
    with open_connection(service.url) as connection:
        connection.sendall(first + b"GET /heal")
        response = read_until_closed(connection)

    assert response.startswith(b"HTTP/1.1 200 ")
    assert b"HTTP/1.1 408 " in response


def test_pipelined_requests_are_not_mistaken_for_a_long_head(service):
    pipelined = head(service, "GET", "/healthz", {"X-Long": "x" * 2_500})
    last = head(service, "GET", "/healthz", {"Connection": "close"})
    with open_connection(service.url) as connection:
        connection.sendall(pipelined * MOST_PIPELINED + last)
        response = read_until_closed(connection)

    assert len(pipelined) * MOST_PIPELINED > 70_000
    assert response.count(b"HTTP/1.1 200 ") == MOST_PIPELINED + 1


@pytest.mark.parametrize(
    ("method", "path", "media_type", "begun"),
    [
        ("POST", "/api/v1/datasets", "application/json", b"{"),
        ("POST", "/api/v1/session", "application/json", b"{"),
        ("PUT", f"{STREET}/frames/a", "multipart/form-data; boundary=x", b"--x"),
        ("POST", f"{STREET}/batches", "application/x-tar", b"run/a.json"),
    ],
)
def test_incomplete_body_times_out_with_408(service, method, path, media_type, begun):
    framing = {"Content-Type": media_type, "Content-Length": "100"}
    with open_connection(service.url) as connection:
        connection.sendall(head(service, method, path, framing) + begun)
        response = read_until_closed(connection)

    assert response.startswith(b"HTTP/1.1 408 ")
    assert b'"code":"request_timeout"' in response
    assert b"connection: close" in response.lower()


def test_json_body_that_arrives_byte_by_byte_times_out_with_408(service):
    """Each pause is short enough; all of them together are too long."""
    framing = {"Content-Type": "application/json", "Content-Length": "1000"}
    sent, is_answered = 0, False
    with open_connection(service.url) as connection:
        connection.sendall(head(service, "POST", "/api/v1/datasets", framing))
        while not is_answered and sent < 100:
            connection.sendall(b" ")
            sent += 1
            is_answered = bool(select.select([connection], [], [], SOON_S / 5)[0])
        response = connection.recv(65536)

    assert is_answered
    assert response.startswith(b"HTTP/1.1 408 ")


def test_batch_that_times_out_keeps_its_stored_frames_and_is_closed(service, admin):
    framing = {"Content-Type": "application/x-tar", "Content-Length": "1000000"}
    whole, half = tar_without_end(frame("whole")), tar_without_end(frame("half"))[:700]
    with open_connection(service.url) as connection:
        connection.sendall(head(service, "POST", f"{STREET}/batches", framing))
        connection.sendall(whole + tar_without_end(frame("next"))[:-512] + half)
        lines = b""
        while b'"end": true' not in lines:
            lines += connection.recv(65536)

    assert lines.startswith(b"HTTP/1.1 200 ")
    assert b'"code": "request_timeout"' in lines
    assert admin.get(f"{STREET}/frames/run/whole").status_code == 200
    assert "unghost_batches_open 0" in admin.get("/metrics").text


def test_slow_sender_does_not_time_out(service):
    body = b'{"name": "slow"}'
    framing = {"Content-Type": "application/json", "Content-Length": str(len(body))}
    with open_connection(service.url) as connection:
        connection.sendall(head(service, "POST", "/api/v1/datasets", framing))
        for byte in body:
            connection.sendall(bytes([byte]))
        response = connection.recv(65536)

    assert response.startswith(b"HTTP/1.1 201 ")
