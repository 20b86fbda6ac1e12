"""Limits the number of open connections, and chooses which to close for a new one.

Each connection needs a file descriptor, as files and the database do, and clients need
no token to connect. At the limit, the connection that has been idle longest is closed
for the new one; if none is idle, one whose client has sent no valid token. If all have
a token and a request in progress, the new connection is refused.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from itertools import chain
from typing import Final, Protocol

from prometheus_client.core import CollectorRegistry, Counter, GaugeMetricFamily, Metric

from app.logs import server_log
from app.settings import Settings

RESERVED_DESCRIPTORS: Final = 320
"""Descriptors that are kept for other uses than connections of clients.

They are the database (two for each of 48 connections), files read and written in
threads, child processes, the storage, the listener, and `MOST_TURNED_AWAY`.
"""
MOST_CONNECTIONS: Final = 2048
LEAST_CONNECTIONS: Final = 16
MOST_TURNED_AWAY: Final = 64
"""How many refused connections get a response at the same time; others are closed."""
_WARN_AGAIN_S: Final = 60.0


class Connection(Protocol):
    """The interface of a connection that `Connections` uses."""

    @property
    def is_quiet(self) -> bool:
        """Whether no bytes wait to be read or sent."""

    @property
    def is_known(self) -> bool:
        """Whether its client has sent a valid token or session."""

    def give_way(self) -> None:
        """Close at once, to make room for another connection."""


class Connections:
    """The connections of one server; used on its event loop only.

    `most` is the maximum number of connections.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._open: dict[Connection, None] = {}
        self._idle: dict[Connection, None] = {}
        self.turned_away: set[Connection] = set()
        """Refused connections whose response is being sent."""
        self._warned_at = float("-inf")
        self._counters = CollectorRegistry()
        self._made_room = Counter(
            "unghost_connections_closed_for_others_total",
            "Connections closed to make room for new ones.",
            registry=self._counters,
        )
        self._refused = Counter(
            "unghost_connections_refused_total",
            "Connections refused because the limit was reached.",
            registry=self._counters,
        )

    @classmethod
    def of(cls, settings: Settings) -> Connections:
        """With the limit of the settings and of the available descriptors."""
        room = room_for_connections(descriptor_limit())
        most = settings.max_connections or MOST_CONNECTIONS
        if settings.max_connections is not None and most > room:
            server_log.warning(
                "UNGHOST_MAX_CONNECTIONS is %d, but the limit of open files allows "
                "only %d connections",
                most,
                room,
            )
        return cls(min(most, room))

    def refusal(self, connection: Connection) -> str | None:
        """Admit a connection, closing another if necessary; or why it is refused."""
        if len(self._open) >= self.most:
            now = time.monotonic()
            if now - self._warned_at >= _WARN_AGAIN_S:
                self._warned_at = now
                server_log.warning(
                    "all %d connections are in use: idle ones are closed to make room",
                    self.most,
                )
            idle = (other for other in self._idle if other.is_quiet)
            unknown = (other for other in self._open if not other.is_known)
            giving_way = next(chain(idle, unknown), None)
            if giving_way is None:
                self._refused.inc()
                return (
                    f"all {self.most} connections of this service are in use; try again"
                )
            self._made_room.inc()
            self.leave(giving_way)
            giving_way.give_way()
        self._open[connection] = self._idle[connection] = None
        return None

    def leave(self, connection: Connection) -> None:
        """Remove a connection that has ended, even if it was not admitted."""
        self.turned_away.discard(connection)
        self._idle.pop(connection, None)
        self._open.pop(connection, None)

    def wait(self, connection: Connection) -> None:
        """Mark a connection as idle: it waits for a request."""
        if connection in self._open:
            self._idle[connection] = None

    def work(self, connection: Connection) -> None:
        """Mark a connection as not idle: a request has begun to arrive."""
        self._idle.pop(connection, None)

    def metrics(self) -> Iterator[Metric]:
        text = "Connections that are open."
        yield GaugeMetricFamily("unghost_connections_open", text, len(self._open))
        text = "Connections that may be open at the same time."
        yield GaugeMetricFamily("unghost_connections_max", text, self.most)
        yield from self._counters.collect()


def room_for_connections(limit: int | None) -> int:
    """How many connections a limit on descriptors allows.

    Each needs two: one for itself, and one for the file in its response.
    """
    if limit is None:
        return MOST_CONNECTIONS
    return max(LEAST_CONNECTIONS, (limit - RESERVED_DESCRIPTORS) // 2)


_WANTED: Final = 65_536
_ALWAYS_ALLOWED: Final = 10_240
"""What macOS allows a process, even if it reports that there is no limit."""


def raise_descriptor_limit() -> int | None:
    """Raise the soft limit on descriptors (RLIMIT_NOFILE); returns the new limit.

    Returns None if the system has no such limit, as on Windows. If it cannot be raised,
    it stays the same.
    """
    if sys.platform == "win32":
        return None
    import resource  # the module does not exist on Windows

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return None
    for limit in (_WANTED, _ALWAYS_ALLOWED):
        most = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        if most <= soft:
            break
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        except (OSError, ValueError):
            continue
        return most
    return soft


def descriptor_limit() -> int | None:
    """The soft limit on descriptors (RLIMIT_NOFILE); None if there is none."""
    if sys.platform == "win32":
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return None if soft == resource.RLIM_INFINITY else soft
