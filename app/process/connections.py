"""Limits the number of open connections, and chooses which to close for a new one.

Each connection needs a file descriptor, as files and the database do, and clients need
no token to connect. At the limit, the connection that has been idle longest is closed
for the new one; if none is idle, one whose client has sent no valid token. If all
connections, or all from one address, have a token and a request in progress, the new
connection is refused.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from ipaddress import IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network
from typing import Final, Protocol

from prometheus_client.core import CollectorRegistry, Counter, GaugeMetricFamily, Metric

from app.logs import server_log
from app.settings import ANY_HOST, Settings

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
_IPV6_NETWORK_BITS: Final = 64


class Connection(Protocol):
    """The interface of a connection that `Connections` uses."""

    @property
    def address(self) -> str | None:
        """The address of its peer, regardless of any header."""

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

    `most` is the maximum number of connections, `most_of_one` that of one address. The
    addresses of trusted proxies have no limit of their own: many people share them.
    """

    def __init__(
        self, most: int, most_of_one: int | None = None, proxies: Iterable[str] = ()
    ) -> None:
        self.most = most
        self.most_of_one = most_of_one or max(1, most // 2)
        self._proxies = _Proxies(proxies)
        self._open: dict[Connection, str] = {}
        self._by_origin: defaultdict[str, int] = defaultdict(int)
        self._waiting: dict[Connection, None] = {}
        self._waiting_at: defaultdict[str, dict[Connection, None]] = defaultdict(dict)
        self.turned_away: set[Connection] = set()
        """Refused connections whose response is being sent."""
        self._warned_at = float("-inf")
        self._counted = CollectorRegistry()
        self._made_room = Counter(
            "unghost_connections_closed_for_others_total",
            "Connections closed to make room for new ones.",
            registry=self._counted,
        )
        self._refused = Counter(
            "unghost_connections_refused_total",
            "Connections refused because the limit was reached.",
            registry=self._counted,
        )

    @classmethod
    def of(cls, settings: Settings) -> Connections:
        """With the limits of the settings and of the available descriptors."""
        room = room_for_connections(descriptor_limit())
        wanted = settings.max_connections
        most = min(wanted or MOST_CONNECTIONS, room)
        if wanted is not None and wanted > room:
            server_log.warning(
                "UNGHOST_MAX_CONNECTIONS is %d, but the limit of open files allows "
                "only %d connections",
                wanted,
                room,
            )
        of_one = settings.max_connections_per_address
        return cls(most, of_one, settings.trusted_proxies)

    def refusal(self, connection: Connection) -> str | None:
        """Admit a connection, closing another if necessary; or why it is refused."""
        origin = origin_of(connection.address)
        if self._count_at(origin, connection.address) >= self.most_of_one:
            waiting = self._waiting_at[origin]
            everybody = [one for one, at in self._open.items() if at == origin]
            full = f"all {self.most_of_one} connections for one address"
        elif len(self._open) >= self.most:
            waiting, everybody = self._waiting, list(self._open)
            full = f"all {self.most} connections of this service"
        else:
            self._enter(connection, origin)
            return None
        self._warn(full, origin)
        giving_way = next(_candidates(waiting, everybody), None)
        if giving_way is None:
            self._refused.inc()
            return f"{full} are in use; try again"
        self._made_room.inc()
        self.leave(giving_way)
        giving_way.give_way()
        self._enter(connection, origin)
        return None

    def _count_at(self, origin: str, address: str | None) -> int:
        return 0 if address in self._proxies else self._by_origin.get(origin, 0)

    def _enter(self, connection: Connection, origin: str) -> None:
        self._open[connection] = origin
        self._by_origin[origin] += 1
        self.wait(connection)

    def leave(self, connection: Connection) -> None:
        """Remove a connection that has ended, even if it was not admitted."""
        self.turned_away.discard(connection)
        self.work(connection)
        origin = self._open.pop(connection, None)
        if origin is None:
            return
        self._by_origin[origin] -= 1
        if not self._by_origin[origin]:
            del self._by_origin[origin]
            self._waiting_at.pop(origin, None)

    def wait(self, connection: Connection) -> None:
        """Mark a connection as idle: it waits for a request."""
        origin = self._open.get(connection)
        if origin is not None:
            self._waiting[connection] = None
            self._waiting_at[origin][connection] = None

    def work(self, connection: Connection) -> None:
        """Mark a connection as not idle: a request has begun to arrive."""
        origin = self._open.get(connection)
        if origin is not None:
            self._waiting.pop(connection, None)
            self._waiting_at[origin].pop(connection, None)

    def metrics(self) -> Iterator[Metric]:
        """The metrics of connections."""
        text = "Connections that are open."
        yield GaugeMetricFamily("unghost_connections_open", text, len(self._open))
        text = "Connections that may be open at the same time."
        yield GaugeMetricFamily("unghost_connections_max", text, self.most)
        yield from self._counted.collect()

    def _warn(self, full: str, origin: str) -> None:
        now = time.monotonic()
        if now - self._warned_at < _WARN_AGAIN_S:
            return
        self._warned_at = now
        server_log.warning(
            "%s are in use, and %s opened another: idle ones are closed to make room",
            full,
            origin,
        )


def origin_of(address: str | None) -> str:
    """The key for counting an address: an IPv4 address, or the /64 network of IPv6."""
    try:
        found = ip_address(address or "")
    except ValueError:
        return address or "-"
    if isinstance(found, IPv6Address):
        if found.ipv4_mapped is not None:
            return str(found.ipv4_mapped)
        return str(ip_network((int(found), _IPV6_NETWORK_BITS), strict=False))
    return str(found)


def room_for_connections(limit: int | None) -> int:
    """How many connections a limit on descriptors allows.

    Each needs two: one for itself, and one for the file in its response.
    """
    if limit is None:
        return MOST_CONNECTIONS
    return max(LEAST_CONNECTIONS, (limit - RESERVED_DESCRIPTORS) // 2)


def _candidates(
    waiting: Iterable[Connection], everybody: Iterable[Connection]
) -> Iterator[Connection]:
    """Connections that may be closed for a new one, the best candidate first."""
    yield from (one for one in waiting if one.is_quiet)
    yield from (one for one in everybody if not one.is_known)


class _Proxies:
    """Addresses and networks of the proxies that are trusted."""

    def __init__(self, names: Iterable[str]) -> None:
        given = set(names)
        self._are_all = ANY_HOST in given
        self._networks: list[IPv4Network | IPv6Network] = [
            ip_network(name, strict=False) for name in given - {ANY_HOST}
        ]

    def __contains__(self, address: str | None) -> bool:
        if self._are_all or not self._networks:
            return self._are_all
        try:
            found = ip_address(address or "")
        except ValueError:
            return False
        return any(found in network for network in self._networks)


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
    for wanted in (_WANTED, _ALWAYS_ALLOWED):
        most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
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
