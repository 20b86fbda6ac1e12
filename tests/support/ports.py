"""Ports for programs that need the same port again after a restart."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

HOST = "127.0.0.1"
_CHOICE = range(20_000, 30_000)
"""Below those from which systems take ports for connections and for port 0."""


@contextmanager
def reserved_port() -> Iterator[int]:
    """A TCP port of this machine on which nobody else listens until the block ends.

    A port that the system picks may be given to any other connection while its server
    is stopped. This one is outside the range from which systems pick, and a UDP socket
    with the same number reserves it among the tests.
    """
    for port in _CHOICE:
        with socket.socket(type=socket.SOCK_DGRAM) as claim, socket.socket() as probe:
            # As servers do: a port with closed connections in TIME_WAIT counts as free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                claim.bind((HOST, port))
                probe.bind((HOST, port))
            except OSError:
                continue
            probe.close()
            yield port
            return
    raise AssertionError("every port is in use")
