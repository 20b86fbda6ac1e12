"""Who is asking: found by the secret of a request, and remembered for a moment.

Who was let in a moment ago, so that many requests in a row need not all ask the
database; when each token was used, and how many were refused, until `upkeep`
writes it down.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from threading import Lock
from typing import Annotated, Final

from fastapi import Depends, Request
from sqlalchemy import event
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool

from app.access.audit import AuditTrail
from app.access.service import by_secret
from app.db.base import utc_now
from app.errors import Forbidden, Unauthorised
from app.http.deps import WriteSession, current_principal, database_of, services_of
from app.security import (
    SAFE_METHODS,
    Principal,
    bearer_token,
    comes_from_no_other_page,
    hash_secret,
)

REMEMBERED_S: Final = 1.0
_MOST: Final = 1024
_MOST_NAMED: Final = 3


class TokenGate:
    """Finds who is asking by the token, or the session, in `Authorization`."""

    async def identify(self, request: Request) -> Principal:
        """Who showed the secret of this request.

        Raises
        ------
        Unauthorised
            There is no secret, or none that is valid.
        Forbidden
            The page's session would write for another page.
        """
        header = request.headers.get("authorization")
        if header is None:
            raise Unauthorised("show a token: Authorization: Bearer ug_...")
        callers = services_of(request).one(RecentCallers)
        principal = callers.find(header)
        if principal is None:
            before = callers.taken_back
            secret = bearer_token(header) or ""
            with counting_wrong(request):
                principal = await run_in_threadpool(_look_up, request, secret)
            callers.remember(header, principal, before)
        services_of(request).one(LastUses).note(principal.token_id)
        page_writes = (
            principal.session_hash is not None and request.method not in SAFE_METHODS
        )
        if page_writes and not comes_from_no_other_page(request.headers):
            raise Forbidden("the page's session only writes for the page itself")
        return principal


@contextmanager
def counting_wrong(request: Request) -> Iterator[None]:
    """Around looking a secret up: a wrong one is counted, for the log.

    Nobody has to wait for having shown wrong ones. Each secret has 256 random bits, so
    trying finds none; and many people share the address of a proxy or of a machine.
    """
    try:
        yield
    except Unauthorised:
        address = request.client.host if request.client else None
        services_of(request).one(WrongSecrets).note(address or "-")
        raise


def _look_up(request: Request, secret: str) -> Principal:
    with database_of(request).read() as session:
        return by_secret(session, secret)


class RecentCallers:
    """Principals by the hash of what they showed, for a second.

    What is revoked in this process counts at once; in another, within a second.
    """

    def __init__(self) -> None:
        self._held: dict[str, tuple[float, Principal]] = {}
        self.taken_back = 0
        """How often something was revoked; read before a token is looked up."""

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


async def audit_trail(request: Request, session: WriteSession) -> AuditTrail:
    """Where this request notes what it does: in the transaction that does it."""
    return AuditTrail(session, current_principal(request))


Audited = Annotated[AuditTrail, Depends(audit_trail)]
