"""Who listens at an address of this machine, as Linux tells it; others tell nothing.

`discovery` asks `listening_uids` alone, and nothing of the kernel's tables is known
there: how they are written, and which sockets take a connection, is all in here.
"""

from __future__ import annotations

import ipaddress
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_TABLES: Final = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
_LISTEN: Final = "0A"
_ANY: Final = {4: ipaddress.ip_address("0.0.0.0"), 6: ipaddress.ip_address("::")}
_LOCALHOST: Final = ("127.0.0.1", "::1")

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


@dataclass(frozen=True)
class _Listener:
    address: Address
    port: int
    uid: int


def listening_uids(host: str, port: int) -> frozenset[int]:
    """The users whose programs a connection to this loopback address could reach.

    Empty where nobody listens in this network namespace, and on other systems.
    """
    if sys.platform != "linux":
        return frozenset()
    there = [one for one in _listeners() if one.port == port]
    # Which of its addresses `localhost` becomes is decided later: all count.
    names = _LOCALHOST if host == "localhost" else (host,)
    return frozenset(uid for name in names for uid in _reached(_plain(name), there))


def _reached(address: Address, there: list[_Listener]) -> set[int]:
    found = {
        one.uid for one in there if one.address in (address, _ANY[address.version])
    }
    if not found and address.version == 4:
        # A socket of IPv6 takes connections of IPv4 that no other one takes.
        found = {one.uid for one in there if one.address == _ANY[6]}
    return found


def _listeners() -> Iterator[_Listener]:
    for table in _TABLES:
        try:
            lines = table.read_text("ascii").splitlines()[1:]
        except OSError:
            continue
        for line in lines:
            fields = line.split()
            if fields[3] == _LISTEN:
                address, port = fields[1].split(":")
                yield _Listener(_decoded(address), int(port, 16), int(fields[7]))


def _decoded(digits: str) -> Address:
    # Words of 32 bits, each in the order of bytes of this machine.
    words = (int(digits[at : at + 8], 16) for at in range(0, len(digits), 8))
    packed = b"".join(word.to_bytes(4, sys.byteorder) for word in words)
    return _unmapped(ipaddress.ip_address(packed))


def _plain(host: str) -> Address:
    return _unmapped(ipaddress.ip_address(host))


def _unmapped(address: Address) -> Address:
    mapped = address.ipv4_mapped if address.version == 6 else None
    return mapped or address
