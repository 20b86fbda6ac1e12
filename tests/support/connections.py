"""Reads what a server sends on a connection of a test's own."""

from __future__ import annotations

import socket


def read_until_closed(connection: socket.socket) -> bytes:
    """Everything received until the server closes the connection."""
    return b"".join(iter(lambda: connection.recv(65536), b""))
