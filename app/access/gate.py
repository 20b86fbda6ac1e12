"""Who is asking: found by the secret of a request, and remembered for a moment.

Who was let in a moment ago, so that many requests in a row need not all ask the
database; when each token was used, and how many were refused, until `token_upkeep`
writes it down.
"""

from __future__ import annotations

import time
from collections import Counter
from datetime import datetime
from threading import Lock
from typing import Final

from sqlalchemy import event
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.security import Principal, hash_secret

REMEMBERED_S: Final = 1.0
_MOST: Final = 1024
_MOST_NAMED: Final = 3


class RecentCallers:
    """Principals by the hash of what they showed, for a second.

    What is taken back in this process counts at once; in another, within a second.
    """

    def __init__(self) -> None:
        self._held: dict[str, tuple[float, Principal]] = {}
        self.taken_back = 0
        """How often something was taken back; whoever looks up notes it before."""

    def find(self, shown: str) -> Principal | None:
        """Who showed this within the last second."""
        until, principal = self._held.get(hash_secret(shown), (0.0, None))
        return principal if time.monotonic() < until else None

    def remember(self, shown: str, principal: Principal, taken_back: int) -> None:
        """Keep an answer of the database, unless it may be outdated already."""
        if taken_back != self.taken_back:
            return
        if len(self._held) >= _MOST:
            self._held.clear()
        self._held[hash_secret(shown)] = (time.monotonic() + REMEMBERED_S, principal)

    def forget_on_commit(self, session: Session) -> None:
        """This transaction takes something back: from its end on, nobody is known."""
        event.listen(session, "after_commit", self._forget, once=True)

    def _forget(self, _session: Session) -> None:
        self.taken_back += 1
        self._held.clear()


class LastUses:
    """When tokens were used, by their ids; one entry each, however often it is used."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._at: dict[int, datetime] = {}

    def note(self, token_id: int) -> None:
        """It was used now."""
        with self._lock:
            self._at[token_id] = utc_now()

    def take(self) -> dict[int, datetime]:
        """What was noted since the last time."""
        with self._lock:
            taken, self._at = self._at, {}
        return taken

    def put_back(self, taken: dict[int, datetime]) -> None:
        """It could not be written; what was noted meanwhile is later."""
        with self._lock:
            self._at = {**taken, **self._at}


class WrongSecrets:
    """How many wrong tokens, sessions, codes and keys came, by address."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._from: Counter[str] = Counter()
        self._count = 0

    def note(self, address: str) -> None:
        """One came from there; only so many addresses are told apart."""
        with self._lock:
            self._count += 1
            if address in self._from or len(self._from) < _MOST:
                self._from[address] += 1

    def take(self) -> str:
        """In words, what came since the last time; empty if nothing did."""
        with self._lock:
            count, self._count = self._count, 0
            by_address, self._from = self._from, Counter()
        named = by_address.most_common(_MOST_NAMED)
        parts = [f"{number} from {address}" for address, number in named]
        others = count - sum(number for _, number in named)
        if others:
            parts.append(f"{others} from elsewhere")
        if not parts:
            return ""
        return f"{count} wrong tokens, sessions, codes or keys: {', '.join(parts)}"
