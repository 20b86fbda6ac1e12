"""Identifies callers by the secret in a request.

Three things are kept in memory: a cache of the callers of the last second, so that not
every request queries the database; the time at which each token was last used; and the
number of wrong secrets. Once a minute the last two are written, the uses into the
database, so that no GET has to write a row, and the wrong secrets into the log alone,
so that nobody without a token can fill the database.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from functools import partial
from threading import Lock
from typing import Annotated, Final

from fastapi import Depends, Request
from sqlalchemy import Connection, event
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool

from app.access.audit import AuditTrail
from app.access.queries import Tokens
from app.access.service import by_session, by_token, require_valid
from app.background import Task, attempt, repeating
from app.context import ServiceContext
from app.db.base import utc_now
from app.errors import Forbidden, Unauthorised
from app.http.deps import current_principal, database_of, services_of
from app.http.transaction import WriteSession
from app.logs import server_log
from app.security import (
    SAFE_METHODS,
    SESSION_PREFIX,
    Principal,
    bearer_token,
    comes_from_no_other_page,
    hash_secret,
)

REMEMBERED_S: Final = 1.0
UPKEEP_EVERY_S: Final = 60.0
_MOST: Final = 1024
_MOST_NAMED: Final = 3


class TokenGate:
    """Identifies callers by the token or the session in the header `Authorization`."""

    async def identify(self, request: Request) -> Principal:
        """The caller, by the secret in this request.

        Raises Unauthorised: there is no secret, or it is not valid; Forbidden: another
        web page uses a session of the review page for a write.
        """
        header = request.headers.get("authorization")
        if header is None:
            raise Unauthorised("a token is required: Authorization: Bearer ug_...")
        callers = services_of(request).one(RecentCallers)
        principal = callers.find(header)
        if principal is None:
            before = callers.revocations
            secret = bearer_token(header) or ""
            by = by_session if secret.startswith(SESSION_PREFIX) else by_token

            def look_up() -> Principal:
                with database_of(request).read() as session:
                    return by(session, secret)

            with counting_wrong_secrets(request):
                principal = await run_in_threadpool(look_up)
            callers.remember(header, principal, before)
        services_of(request).one(LastUses).note(principal.token_id)
        is_of_page = principal.session_hash is not None
        page_writes = is_of_page and request.method not in SAFE_METHODS
        if page_writes and not comes_from_no_other_page(request.headers):
            raise Forbidden(
                "a session of the review page may be used for writes by that page only"
            )
        return principal

    def require_valid(self, connection: Connection, principal: Principal) -> None:
        """Raise Unauthorised if the caller's token or session has ended since."""
        require_valid(connection, principal)


@contextmanager
def counting_wrong_secrets(request: Request) -> Iterator[None]:
    """Count an `Unauthorised` raised in the block as a wrong secret, for the log.

    An address with many wrong secrets is not blocked: secrets of 256 random bits cannot
    be guessed, and many people may share the address of a proxy or a machine.
    """
    try:
        yield
    except Unauthorised:
        address = request.client.host if request.client else None
        services_of(request).one(WrongSecrets).note(address or "-")
        raise


class RecentCallers:
    """A cache of the callers of the last second, by the hash of their header.

    A revocation takes effect at once in this process, within a second in others.
    """

    def __init__(self) -> None:
        self._held: dict[str, tuple[float, Principal]] = {}
        self.revocations = 0
        """How often something was revoked; read it before a token is looked up."""

    def find(self, header: str) -> Principal | None:
        """The caller who sent this header within the last second; else None."""
        until, principal = self._held.get(hash_secret(header), (0.0, None))
        return principal if time.monotonic() < until else None

    def remember(self, header: str, principal: Principal, revocations: int) -> None:
        """Cache a caller, unless something was revoked since the look-up began."""
        if revocations != self.revocations:
            return
        if len(self._held) >= _MOST:
            self._held.clear()
        self._held[hash_secret(header)] = (time.monotonic() + REMEMBERED_S, principal)

    def forget_on_commit(self, session: Session) -> None:
        """Clear the cache when this transaction, which revokes something, commits."""

        def forget(_session: Session) -> None:
            self.revocations += 1
            self._held.clear()

        event.listen(session, "after_commit", forget, once=True)


class LastUses:
    """When each token was last used, by its id."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._at: dict[int, datetime] = {}

    def note(self, token_id: int) -> None:
        """Note that a token is used now."""
        with self._lock:
            self._at[token_id] = utc_now()

    def take(self) -> dict[int, datetime]:
        """Remove and return the times noted since the last call."""
        with self._lock:
            taken, self._at = self._at, {}
        return taken

    def put_back(self, taken: dict[int, datetime]) -> None:
        """Restore times that could not be written, except where newer ones exist."""
        with self._lock:
            self._at = {**taken, **self._at}


class WrongSecrets:
    """Counts wrong tokens, sessions, codes and keys by the address of the client."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._from: Counter[str] = Counter()
        self._count = 0

    def note(self, address: str) -> None:
        """Count one wrong secret; beyond `_MOST` addresses, in the total only."""
        with self._lock:
            self._count += 1
            if address in self._from or len(self._from) < _MOST:
                self._from[address] += 1

    def take(self) -> str:
        """A text with the counts since the last call; empty if there were none."""
        with self._lock:
            count, self._count = self._count, 0
            by_address, self._from = self._from, Counter()
        named = by_address.most_common(_MOST_NAMED)
        parts = [f"{number} from {address}" for address, number in named]
        others = count - sum(number for _, number in named)
        if others:
            parts.append(f"{others} from other addresses")
        if not parts:
            return ""
        return f"{count} with a wrong token, session, code or key: {', '.join(parts)}"


@contextmanager
def keeping_tokens(context: ServiceContext) -> Iterator[None]:
    """Call `write_upkeep` once a minute until the block ends, and then once more."""
    purpose = "note the use of tokens"
    work = partial(write_upkeep, context)
    task = Task("token upkeep", purpose, work, UPKEEP_EVERY_S)
    try:
        with repeating(context, task):
            yield
    finally:
        attempt(context, task)


def write_upkeep(context: ServiceContext) -> None:
    """Write the times of last use, and log wrong secrets."""
    wrong = context.one(WrongSecrets).take()
    if wrong:
        server_log.warning("requests refused within a minute: %s", wrong)
    uses = context.one(LastUses).take()
    if uses:
        try:
            with context.database.write() as session:
                for token_id, at in sorted(uses.items()):
                    Tokens(session).note_use(token_id, at)
        except BaseException:
            context.one(LastUses).put_back(uses)
            raise


async def audit_trail(request: Request, session: WriteSession) -> AuditTrail:
    """The audit log for this request, in the transaction that does its work."""
    return AuditTrail(session, current_principal(request))


Audited = Annotated[AuditTrail, Depends(audit_trail)]
