"""Ports for programs that have to be told one, and keep it while they are stopped."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

HOST = "127.0.0.1"
_CHOICE = range(20_000, 30_000)
"""Below those from which systems take ports for connections and for port 0."""


@contextmanager
def reserved_port() -> Iterator[int]:
    """A TCP port of this machine on which nobody else listens until the end.

    A port that the system picks is free again at once, and while a server is stopped
    the next connection of any program may get it. This one is of no system's choice,
    and a UDP socket on the same number keeps it from other tests.
    """
    for port in _CHOICE:
        with socket.socket(type=socket.SOCK_DGRAM) as claim, socket.socket() as probe:
            # As servers do: a port whose last connections linger is free.
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
