"""Giving people tokens and taking them back."""

from __future__ import annotations

from datetime import datetime

from app.db.access_tables import Token
from app.db.base import utc_now
from app.errors import Conflict, NotFound, Unprocessable
from app.repositories.tokens import Tokens
from app.security import Role, hash_secret, new_token
from app.services.audit import Act, AuditTrail
from app.services.timestamps import rfc3339


def issue(
    audit: AuditTrail, name: str, role: Role, expires_at: datetime | None
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
    tokens = Tokens(audit.session)
    if tokens.by_name(name) is not None:
        raise Conflict(f"there is a token named {name!r}, perhaps a revoked one")
    secret = new_token()
    token = Token(
        name=name, role=role.value, hash=hash_secret(secret), expires_at=expires_at
    )
    tokens.add(token)
    until = None if expires_at is None else rfc3339(expires_at)
    audit.note(
        Act.TOKEN_CREATED, name, token_id=token.id, role=role.value, expires_at=until
    )
    return token, secret


def revoke(audit: AuditTrail, token_id: int) -> None:
    """Take a token back, and end the sessions that it opened.

    Raises
    ------
    Conflict
        Nobody could make tokens afterwards.
    """
    tokens = Tokens(audit.session)
    token = tokens.by_id(token_id)
    if token is None:
        raise NotFound("token", token_id)
    now = utc_now()
    if tokens.valid_ids(Role.ADMIN.value, now) == [token_id]:
        raise Conflict(f"token {token.name!r} is the last one of an admin")
    if token.revoked_at is None:
        tokens.revoke(token, now)
        audit.note(Act.TOKEN_REVOKED, token.name, token_id=token_id)
