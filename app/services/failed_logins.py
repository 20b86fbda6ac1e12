"""How many tokens were guessed from where: who tries too many has to wait.

Tokens have 256 random bits, so nobody finds one by trying; but trying costs the service
work and fills its log. Counted are different wrong tokens: a program that shows the
same old one again and again is no guesser, and keeps nobody else out.
"""

from __future__ import annotations

import ipaddress
import logging
import math
import time
from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Final

from app.errors import TooManyRequests
from app.security import hash_secret

WINDOW_S: Final = 60.0
_MOST_PLACES: Final = 4096
_MOST_PROVEN: Final = 4096
_MOST_LOCKED: Final = 100
_SIXTY_FOUR: Final = 64

log = logging.getLogger(__name__)


class FailedLogins:
    """Wrong tokens, sessions and codes by where they came from, for a minute."""

    def __init__(self, most: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._most = most
        self._clock = clock
        self._lock = Lock()
        self._failed: OrderedDict[str, dict[str, float]] = OrderedDict()
        self._proven: OrderedDict[tuple[str, str], None] = OrderedDict()
        self._locked: list[str] = []

    def check(self, address: str | None, secret: str) -> None:
        """Let the secret be looked up.

        What was right from there before is looked up always: whoever works already is
        not kept from it by a neighbour who guesses.

        Raises
        ------
        TooManyRequests
            Too many different wrong ones came from there within a minute.
        """
        place, digest = place_of(address), hash_secret(secret)
        with self._lock:
            wait_s = self._wait(place)
            if wait_s <= 0 or (place, digest) in self._proven:
                return
        raise TooManyRequests(
            f"{self._most} wrong tokens were tried from this address within a minute; "
            f"try again in {wait_s} s",
            retry_after_s=wait_s,
            code="too_many_logins",
        )

    def failed(self, address: str | None, secret: str) -> None:
        """The secret was wrong."""
        place, digest = place_of(address), hash_secret(secret)
        with self._lock:
            self._proven.pop((place, digest), None)
            tried = self._failed.setdefault(place, {})
            self._failed.move_to_end(place)
            tried[digest] = self._clock()
            while len(tried) > self._most:
                del tried[min(tried, key=tried.__getitem__)]
            while len(self._failed) > _MOST_PLACES:
                self._failed.popitem(last=False)
            is_full = len(tried) == self._most
            if is_full and len(self._locked) < _MOST_LOCKED:
                self._locked.append(place)
        if is_full:
            log.warning("%d wrong tokens within a minute from %s", self._most, place)

    def take_locked(self) -> list[str]:
        """From where too many were tried since the last time; a hundred at most."""
        with self._lock:
            taken, self._locked = self._locked, []
        return taken

    def succeeded(self, address: str | None, secret: str) -> None:
        """The secret was right."""
        proven = (place_of(address), hash_secret(secret))
        with self._lock:
            self._proven[proven] = None
            self._proven.move_to_end(proven)
            while len(self._proven) > _MOST_PROVEN:
                self._proven.popitem(last=False)

    def _wait(self, place: str) -> int:
        """Seconds until one more may be wrong; 0: now."""
        now = self._clock()
        tried = self._failed.get(place, {})
        for digest in [one for one, at in tried.items() if now - at >= WINDOW_S]:
            del tried[digest]
        if len(tried) < self._most:
            return 0
        return max(1, math.ceil(min(tried.values()) + WINDOW_S - now))


def place_of(address: str | None) -> str:
    """What is counted as one: an address, or the network that one IPv6 house has."""
    try:
        found = ipaddress.ip_address(address or "")
    except ValueError:
        return address or "-"
    if isinstance(found, ipaddress.IPv6Address):
        if found.ipv4_mapped is not None:
            return str(found.ipv4_mapped)
        return str(ipaddress.ip_network((int(found), _SIXTY_FOUR), strict=False))
    return str(found)
