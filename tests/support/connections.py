"""Connections of a test's own, for requests that no HTTP client would send."""

import socket
from collections.abc import Mapping
from urllib.parse import urlsplit

from tests.support.waiting import PATIENCE_S


def open_connection(
    url: str, source: str = "", *, receive_buffer: int | None = None
) -> socket.socket:
    """A connection to the server at `url`, on which nothing was sent.

    It comes from the address `source`, if that is given. With a small `receive_buffer`
    it buffers very little of what the test does not read.
    """
    place = urlsplit(url)
    connection = socket.socket()
    try:
        if receive_buffer is not None:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        connection.settimeout(PATIENCE_S)
        if source:
            connection.bind((source, 0))
        connection.connect((place.hostname, place.port or 80))
    except BaseException:
        connection.close()
        raise
    return connection


def request_head(
    method: str, path: str, headers: Mapping[str, object] | None = None
) -> bytes:
    """The head of a request, with a Host unless `headers` have one."""
    lines = {"Host": "localhost", **(headers or {})}.items()
    head = (f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in lines))
    return "\r\n".join((*head, "", "")).encode()


def read_until_closed(connection: socket.socket) -> bytes:
    """Everything received until the server closes the connection."""
    return b"".join(iter(lambda: connection.recv(65536), b""))


def read_response(connection: socket.socket) -> tuple[int, dict[str, str], bytes]:
    """Read one response: its status, its headers in lower case, and its body."""
    received = b""
    while b"\r\n\r\n" not in received:
        received += _next_piece(connection)
    head, _, body = received.partition(b"\r\n\r\n")
    lines = head.decode().lower().split("\r\n")
    headers = dict(line.split(": ", 1) for line in lines[1:])
    while not (
        body.endswith(b"\r\n0\r\n\r\n")
        if "transfer-encoding" in headers
        else len(body) >= int(headers.get("content-length", "0"))
    ):
        body += _next_piece(connection)
    return int(lines[0].split()[1]), headers, body


def _next_piece(connection: socket.socket) -> bytes:
    piece = connection.recv(65536)
    assert piece, "the server has closed the connection"
    return piece
