"""Who was let in a moment ago: many requests in a row need not all ask the database.

What is taken back in this process counts at once; in another, within a second.
"""

from __future__ import annotations

import time
from typing import Final

from sqlalchemy import event
from sqlalchemy.orm import Session

from app.security import Principal, hash_secret

REMEMBERED_S: Final = 1.0
_MOST: Final = 1024


class RecentCallers:
    """Principals by the hash of what they showed, for a second."""

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
