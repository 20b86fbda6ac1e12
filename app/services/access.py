"""Who may come in: the first token, logging in and out, and telling who is asking."""

from __future__ import annotations

import os
import secrets
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final

from sqlalchemy.orm import Session

from app.db.access_tables import Token
from app.db.base import utc_now
from app.errors import Unauthorised
from app.repositories.tokens import Tokens
from app.security import (
    Principal,
    Role,
    hash_secret,
    new_session_id,
    new_token,
    same_hash,
)
from app.services.audit import Act, AuditTrail

FIRST_TOKEN_NAME: Final = "admin"
_NO_ENTRY: Final = "show a valid token, or log in with one"


def ensure_first_token(session: Session, file: Path) -> str:
    """The token in the file; a new one if there is none or it opens nothing.

    Deleting the file and starting again therefore changes the token. Whoever can do
    that can read the database as well. The database sees only the hash.
    """
    tokens = Tokens(session)
    tokens.end_expired_sessions(utc_now())
    token = _read(file)
    if token and tokens.valid_by_hash(hash_secret(token), utc_now()):
        return token
    token = new_token()
    # The file first: a hash whose token is lost would lock everybody out.
    write_secret(file, token)
    first = tokens.replace(FIRST_TOKEN_NAME, Role.ADMIN.value, hash_secret(token))
    AuditTrail(session).note(
        Act.TOKEN_CREATED, FIRST_TOKEN_NAME, token_id=first.id, role=Role.ADMIN.value
    )
    return token


def write_secret(file: Path, text: str) -> None:
    """Write a file that was never, not even for a moment, readable by others."""
    draft = file.with_name(f".{file.name}.{secrets.token_hex(4)}")
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text + "\n")
            stream.flush()
            os.fsync(stream.fileno())
        draft.replace(file)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def log_in(session: Session, principal: Principal, lifetime: timedelta) -> str:
    """Open a session for the page; the value of its cookie."""
    session_id = new_session_id()
    Tokens(session).open_session(
        principal.token_id, hash_secret(session_id), utc_now() + lifetime
    )
    return session_id


def log_out(session: Session, principal: Principal) -> None:
    """End the session of this browser; a bearer token has none."""
    if principal.session_hash is not None:
        Tokens(session).end_session(principal.session_hash)


def expiry(session: Session, principal: Principal) -> datetime | None:
    """When whoever is asking has to come with another token; None: never."""
    return Tokens(session).expiry(principal.token_id, principal.session_hash)


def by_token(session: Session, token: str) -> Principal:
    """Who shows this bearer token.

    Raises
    ------
    Unauthorised
        It is unknown, revoked or expired. Which of the last two is said: only who
        holds the token can ask.
    """
    digest, now = hash_secret(token), utc_now()
    tokens = Tokens(session)
    row = tokens.valid_by_hash(digest, now)
    if row is None or not same_hash(row.hash, digest):
        raise _refused(tokens.by_hash(digest), now)
    return Principal(row.id, row.name, Role(row.role))


def by_session(session: Session, session_id: str) -> Principal:
    """Who shows this cookie; raises `Unauthorised` like `by_token`."""
    digest, now = hash_secret(session_id), utc_now()
    tokens = Tokens(session)
    row = tokens.valid_by_session(digest, now)
    if row is None or not same_hash(row.hash, digest):
        raise _refused(tokens.that_opened(digest), now, "session_expired")
    return Principal(row.id, row.name, Role(row.role), session_hash=digest)


def _refused(token: Token | None, now: datetime, otherwise: str = "") -> Unauthorised:
    """Why a token, or the session that it opened, lets nobody in (any more)."""
    if token is None:
        return Unauthorised(_NO_ENTRY)
    if token.revoked_at is not None:
        return Unauthorised(
            "this token was taken back; ask an admin for another one",
            code="token_revoked",
        )
    if token.expires_at is not None and token.expires_at <= now:
        return Unauthorised(
            f"this token expired on {token.expires_at:%Y-%m-%d at %H:%M} UTC; "
            "ask an admin for another one",
            code="token_expired",
        )
    return Unauthorised(_NO_ENTRY, code=otherwise)


def _read(file: Path) -> str | None:
    try:
        return file.read_text(encoding="utf-8").strip()
    except FileNotFoundError:
        return None
