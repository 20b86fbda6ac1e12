"""Clients that stop reading their answers are disconnected; slow ones are not."""

import threading
import time
from pathlib import Path

import pytest

from app.package import static_dir
from app.process.server import MOST_PIPELINED
from tests.support.archives import frame, tar_without_end
from tests.support.connections import open_connection, read_until_closed, request_head
from tests.support.live import live
from tests.support.probe_routes import endless_response_stopped
from tests.support.waiting import until

pytestmark = pytest.mark.long

LONG_S = 60
SOON_S = 0.5
LARGE = max(
    (static_dir() / "vendor").glob("*.js"), key=lambda file: file.stat().st_size
)
IO = Path("/proc/self/io")
ADDRESS = f"/static/vendor/{LARGE.name}"


@pytest.fixture
def service(tmp_path):
    with live(tmp_path / "data", answer_wait_s=SOON_S) as running:
        yield running


def reluctant_reader(service):
    """A connection that buffers very little of what the test does not read."""
    return open_connection(service.url, receive_buffer=4096)


def wait_until_only_connection(service):
    """Wait until the connection that asks is the only one."""
    with service.admin() as admin:
        until(lambda: "unghost_connections_open 1.0\n" in admin.get("/metrics").text)


def test_connection_with_unread_responses_is_closed(service):
    with reluctant_reader(service) as connection:
        connection.sendall(request_head("GET", ADDRESS) * (MOST_PIPELINED + 1))
        wait_until_only_connection(service)
        with pytest.raises(ConnectionResetError):
            read_until_closed(connection)


def test_unread_stream_is_closed(service):
    endless_response_stopped.clear()
    with reluctant_reader(service) as connection:
        connection.sendall(request_head("GET", "/probe/endless", service.bearer))
        assert endless_response_stopped.wait(LONG_S)
        wait_until_only_connection(service)


def test_batch_with_an_unread_response_is_closed(service):
    with service.admin() as admin:
        admin.post("/api/v1/datasets", json={"name": "street"})
    headers = {
        **service.bearer,
        "Content-Type": "application/x-tar",
        "Content-Length": "1000000000",
    }
    head = request_head("POST", "/api/v1/datasets/street/batches", headers)
    faulty = [{"id": str(number)} for number in range(100)]  # makes long lines
    sent = b"".join(
        tar_without_end(frame(f"f{number}", boxes=faulty)) for number in range(9)
    )
    with reluctant_reader(service) as connection:
        connection.sendall(head + sent)
        assert connection.recv(1)  # the answer has begun
        wait_until_only_connection(service)
        with service.admin() as admin:
            seen = admin.get("/metrics").text

    assert "unghost_batches_open 0.0\n" in seen


def test_stream_ends_on_disconnect_even_with_a_pipelined_request(service):
    endless_response_stopped.clear()
    with reluctant_reader(service) as connection:
        connection.sendall(
            request_head("GET", "/probe/endless", service.bearer)
            + request_head("GET", "/healthz")
        )
        assert connection.recv(1)

    assert endless_response_stopped.wait(LONG_S)


def test_slow_reader_gets_the_complete_response(tmp_path):
    last = request_head("GET", ADDRESS, {"Connection": "close"})
    wait_s, pause = 1, threading.Event()
    received = bytearray()
    with (
        live(tmp_path / "data", answer_wait_s=wait_s) as service,
        reluctant_reader(service) as slow,
    ):
        slow.sendall(request_head("GET", ADDRESS) * MOST_PIPELINED + last)
        begun = time.monotonic()
        while piece := slow.recv(100_000):
            received += piece
            if time.monotonic() - begun < 2 * wait_s:
                pause.wait(wait_s / 20)

    assert received.count(LARGE.read_bytes()) == MOST_PIPELINED + 1


def test_pipelined_requests_are_limited_per_connection(service):
    received = bytearray()
    with reluctant_reader(service) as connection:
        connection.sendall(request_head("GET", "/healthz") * 500)
        try:
            while piece := connection.recv(65536):
                received += piece
        except ConnectionResetError:
            pass

    assert received.count(b"HTTP/1.1 200 ") == MOST_PIPELINED + 1


def bytes_read_by_this_process():
    """How many bytes this process has read from files, without those from sockets."""
    counted = dict(line.split(": ") for line in IO.read_text("ascii").splitlines())
    return int(counted["rchar"])


@pytest.mark.skipif(not IO.exists(), reason="only Linux counts what a process reads")
def test_file_is_not_read_further_after_the_client_disconnects(service, tmp_path):
    size = 1 << 30
    large = service.app.state.large_file = tmp_path / "large"
    with large.open("wb") as file:
        file.truncate(size)
    before = bytes_read_by_this_process()
    with reluctant_reader(service) as connection:
        connection.sendall(request_head("GET", "/probe/large-file", service.bearer))
        assert connection.recv(1)
    over = 'route="/probe/large-file",status="200"} 1'
    with service.admin() as admin:
        until(lambda: over in admin.get("/metrics").text)

    assert bytes_read_by_this_process() - before < size / 4
