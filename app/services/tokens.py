"""Giving people tokens and taking them back."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy.orm import Session

from app.db.access_tables import Token
from app.db.base import utc_now
from app.errors import Conflict, NotFound, Unprocessable
from app.repositories.tokens import Tokens
from app.security import Role, hash_secret, new_token


def issue(
    session: Session, name: str, role: Role, expires_at: datetime | None
) -> tuple[Token, str]:
    """A new token and what to show for it; only its hash is stored.

    Raises
    ------
    Conflict
        The name is taken, if only by a revoked token: reviews carry it.
    Unprocessable
        It would have expired already.
    """
    if expires_at is not None and expires_at <= utc_now():
        raise Unprocessable(f"expires_at {expires_at.isoformat()} is in the past")
    tokens = Tokens(session)
    if tokens.by_name(name) is not None:
        raise Conflict(f"there is a token named {name!r}, perhaps a revoked one")
    secret = new_token()
    token = Token(
        name=name, role=role.value, hash=hash_secret(secret), expires_at=expires_at
    )
    tokens.add(token)
    return token, secret


def revoke(session: Session, token_id: int) -> None:
    """Take a token back, and end the sessions that it opened.

    Raises
    ------
    Conflict
        Nobody could make tokens afterwards.
    """
    tokens = Tokens(session)
    token = tokens.by_id(token_id)
    if token is None:
        raise NotFound("token", token_id)
    now = utc_now()
    if tokens.valid_ids(Role.ADMIN.value, now) == [token_id]:
        raise Conflict(f"token {token.name!r} is the last one of an admin")
    tokens.revoke(token, now)
