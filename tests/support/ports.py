"""Reserves ports for servers that need the same port again after a restart."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager

HOST = "127.0.0.1"
_CANDIDATES = range(20_000, 30_000)
"""Below the ports that systems give to outgoing connections and to port 0."""


@contextmanager
def reserved_port() -> Iterator[int]:
    """A TCP port of this machine that stays free for the test until the block ends.

    While a server is stopped, the system may give a port that it picked to any other
    connection. So this port is outside the range from which systems pick, and a UDP
    socket with the same number keeps other tests from taking it.
    """
    for port in _CANDIDATES:
        with socket.socket(type=socket.SOCK_DGRAM) as claim, socket.socket() as probe:
            # As servers do, count a port with connections in TIME_WAIT as free.
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
