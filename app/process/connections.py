"""Who is connected: how many there may be, and who makes room for the next one.

Each connection takes a descriptor, and so do the files and the database behind it, and
nobody needs a token to connect. When there is no place left, the connection that has
waited longest for a request of its client is closed for the new one; if none waits, one
whose client has shown no token. Only if all places, or all of one address, are taken by
people with a token who are at work, the new one is turned away.
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
"""For the database (two for each of 48 connections), files that are read and written in
threads, child processes, the store, the listener, and `MOST_TURNED_AWAY`."""
MOST_CONNECTIONS: Final = 2048
LEAST_CONNECTIONS: Final = 16
MOST_TURNED_AWAY: Final = 64
"""Connections that are told that there is no place, at the same time."""
_TELL_AGAIN_S: Final = 60.0
_SIXTY_FOUR: Final = 64


class Connection(Protocol):
    """What is asked of a connection."""

    @property
    def address(self) -> str | None:
        """Where it comes from, as the connection itself says."""

    @property
    def is_quiet(self) -> bool:
        """Nothing has come that was not read, and nothing has to be sent any more."""

    @property
    def is_known(self) -> bool:
        """Its client has shown a valid token or session."""

    def give_way(self) -> None:
        """End at once: another one gets its place."""


class Connections:
    """The connections of one server; belongs to its event loop.

    `most` is how many there may be, `most_of_one` how many of one address, unless it is
    that of a trusted proxy: all people behind a proxy share its address.
    """

    def __init__(
        self, most: int, most_of_one: int | None = None, proxies: Iterable[str] = ()
    ) -> None:
        self.most = most
        self.most_of_one = most_of_one or max(1, most // 2)
        self._proxies = _Proxies(proxies)
        self._open: dict[Connection, str] = {}
        self._by_place: defaultdict[str, int] = defaultdict(int)
        self._waiting: dict[Connection, None] = {}
        self._waiting_at: defaultdict[str, dict[Connection, None]] = defaultdict(dict)
        self.turned_away: set[Connection] = set()
        """Those that are being told that there is no place."""
        self._told_at = float("-inf")
        self._counted = CollectorRegistry()
        self._made_room = Counter(
            "unghost_connections_closed_for_others_total",
            "Connections closed because others needed their places.",
            registry=self._counted,
        )
        self._refused = Counter(
            "unghost_connections_refused_total",
            "Connections refused because no place was left.",
            registry=self._counted,
        )

    @classmethod
    def of(cls, settings: Settings) -> Connections:
        """As many as are wanted and as there are descriptors for."""
        room = room_for_connections(descriptor_limit())
        wanted = settings.max_connections
        most = min(wanted or MOST_CONNECTIONS, room)
        if wanted is not None and wanted > room:
            server_log.warning(
                "UNGHOST_MAX_CONNECTIONS is %d, but the limit of open files leaves "
                "room for %d connections: no more are taken",
                wanted,
                room,
            )
        of_one = settings.max_connections_per_address
        return cls(most, of_one, settings.trusted_proxies)

    def refusal(self, connection: Connection) -> str | None:
        """Take a connection in, closing another one if need be; why not, if not."""
        place = place_of(connection.address)
        if self._count_at(place, connection.address) >= self.most_of_one:
            waiting = self._waiting_at[place]
            everybody = [one for one, at in self._open.items() if at == place]
            full = f"all {self.most_of_one} connections for one address"
        elif len(self._open) >= self.most:
            waiting, everybody = self._waiting, list(self._open)
            full = f"all {self.most} connections of this service"
        else:
            self._enter(connection, place)
            return None
        self._tell(full, place)
        giving_way = next(_who_can_wait(waiting, everybody), None)
        if giving_way is None:
            self._refused.inc()
            return f"{full} are in use; try again"
        self._made_room.inc()
        self.leave(giving_way)
        giving_way.give_way()
        self._enter(connection, place)
        return None

    def _count_at(self, place: str, address: str | None) -> int:
        return 0 if address in self._proxies else self._by_place.get(place, 0)

    def _enter(self, connection: Connection, place: str) -> None:
        self._open[connection] = place
        self._by_place[place] += 1
        self.wait(connection)

    def leave(self, connection: Connection) -> None:
        """A connection has ended; one that never entered may be named as well."""
        self.turned_away.discard(connection)
        self.work(connection)
        place = self._open.pop(connection, None)
        if place is None:
            return
        self._by_place[place] -= 1
        if not self._by_place[place]:
            del self._by_place[place]
            self._waiting_at.pop(place, None)

    def wait(self, connection: Connection) -> None:
        """A connection waits for a request of its client from now on."""
        place = self._open.get(connection)
        if place is not None:
            self._waiting[connection] = None
            self._waiting_at[place][connection] = None

    def work(self, connection: Connection) -> None:
        """A request has begun to come on a connection: it does not wait any more."""
        place = self._open.get(connection)
        if place is not None:
            self._waiting.pop(connection, None)
            self._waiting_at[place].pop(connection, None)

    def metrics(self) -> Iterator[Metric]:
        """What Prometheus is told."""
        text = "Connections that are open."
        yield GaugeMetricFamily("unghost_connections_open", text, len(self._open))
        text = "Connections that may be open at the same time."
        yield GaugeMetricFamily("unghost_connections_max", text, self.most)
        yield from self._counted.collect()

    def _tell(self, full: str, place: str) -> None:
        now = time.monotonic()
        if now - self._told_at < _TELL_AGAIN_S:
            return
        self._told_at = now
        server_log.warning(
            "%s are taken, the next one came from %s: idle ones are closed for others",
            full,
            place,
        )


def place_of(address: str | None) -> str:
    """What is counted as one: an address, or the network that one IPv6 house has."""
    try:
        found = ip_address(address or "")
    except ValueError:
        return address or "-"
    if isinstance(found, IPv6Address):
        if found.ipv4_mapped is not None:
            return str(found.ipv4_mapped)
        return str(ip_network((int(found), _SIXTY_FOUR), strict=False))
    return str(found)


def room_for_connections(limit: int | None) -> int:
    """How many connections a limit of descriptors leaves room for.

    Each takes two: one for itself, and one for the file that it is answered with.
    """
    if limit is None:
        return MOST_CONNECTIONS
    return max(LEAST_CONNECTIONS, (limit - RESERVED_DESCRIPTORS) // 2)


def _who_can_wait(
    waiting: Iterable[Connection], everybody: Iterable[Connection]
) -> Iterator[Connection]:
    """Connections that can be closed for a new one, the best to close first."""
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
"""What macOS allows a process even where it says that there is no limit."""


def raise_descriptor_limit() -> int | None:
    """Raise the soft limit (RLIMIT_NOFILE) towards the hard one; what it is then.

    None where the system has no such limit: Windows. One that cannot be raised stays as
    it is.
    """
    if sys.platform == "win32":
        return None
    import resource  # only systems that have such limits have the module

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
    """The soft limit as it is; None where there is none."""
    if sys.platform == "win32":
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return None if soft == resource.RLIM_INFINITY else soft
