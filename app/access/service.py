"""Creates and revokes tokens, logs in and out, and checks who may remove answers."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Final

from sqlalchemy import Connection
from sqlalchemy.orm import Session

from app.access.audit import AuditAction, AuditTrail
from app.access.queries import TokenEnd, Tokens, end_of, is_valid
from app.db.base import existing, insert_row, rfc3339, utc_now
from app.db.tables.access import DownloadLink, LoginCode, LoginSession, Token
from app.errors import Conflict, Forbidden, NotFound, Unauthorised, Unprocessable
from app.security import (
    DOWNLOAD_PREFIX,
    LOGIN_CODE_PREFIX,
    SESSION_PREFIX,
    TOKEN_PREFIX,
    Principal,
    hash_secret,
    includes,
    new_secret,
    same_hash,
)
from unghost.wire.words import Role

CODE_LIFETIME: Final = timedelta(minutes=10)
"""How long a login link can be used, once."""
LINK_LIFETIME: Final = timedelta(minutes=5)
"""How long a download link can be opened, as often as needed."""
MOST_SESSIONS: Final = 100
MOST_CODES: Final = 20
MOST_LINKS: Final = 100
"""Maximum numbers for each token. One more ends the oldest instead of being refused, so
that logging in always works."""
MOST_NAMED: Final = 3
"""How many names of people an error lists; the others are counted."""
_NO_ENTRY: Final = "a valid token or session is required"
_UNKNOWN_TOKEN: Final = (
    "the token that was sent is not accepted: this server does not know it"
)
_UNKNOWN_SESSION: Final = (
    "the session that was sent is not accepted: it has ended, or is another server's"
)


def by_token(session: Session, token: str) -> Principal:
    """The caller with this token.

    Raises Unauthorised: it is unknown, revoked or expired. The error tells the last two
    apart: only somebody who has the token can see them.
    """
    if not token:
        raise Unauthorised(_NO_ENTRY)
    digest, now = hash_secret(token), utc_now()
    tokens = Tokens(session)
    if token.startswith(SESSION_PREFIX):
        # It would open another session, which its own end would not end.
        raise Unauthorised("the token that was sent is not accepted: it is a session's")
    row = tokens.valid_by_hash(digest, now)
    if row is None or not same_hash(row.hash, digest):
        raise _refused(tokens.by_hash(digest), now, _UNKNOWN_TOKEN)
    return Principal(row.id, row.name, row.role)


def by_session(session: Session, secret: str) -> Principal:
    """The caller with this session; raises `Unauthorised` as `by_token` does."""
    digest, now = hash_secret(secret), utc_now()
    tokens = Tokens(session)
    row = tokens.valid_by_session(digest, now)
    if row is None or not same_hash(row.hash, digest):
        token = tokens.by_session_hash(digest)
        raise _refused(token, now, _UNKNOWN_SESSION, "session_expired")
    return Principal(row.id, row.name, row.role, session_hash=digest)


def require_valid(connection: Connection, principal: Principal) -> None:
    """Check in the transaction of a write that its caller is still valid.

    A caller is identified when the head of a request arrives. Its body may take much
    longer, and the token may be revoked meanwhile. Raises Unauthorised: the token or
    the session has ended since.
    """
    now, token_id = utc_now(), principal.token_id
    if not is_valid(connection, token_id, principal.session_hash, now):
        end = end_of(connection, token_id)
        if principal.session_hash:
            raise _refused(end, now, _UNKNOWN_SESSION, "session_expired")
        raise _refused(end, now, _UNKNOWN_TOKEN)


def log_in(audit: AuditTrail, by: str, lifetime: timedelta) -> str:
    """Open a session of the page for the actor; returns its secret.

    `by` says what it was opened with: ``token`` or ``code``.
    """
    secret = new_secret(SESSION_PREFIX)
    ends = utc_now() + lifetime
    if audit.actor is not None:
        ends = min(ends, Tokens(audit.session).expiry(audit.actor) or ends)
    opened = LoginSession(
        hash=hash_secret(secret), token_id=audit.token_id, expires_at=ends
    )
    Tokens(audit.session).open_session(opened, most=MOST_SESSIONS)
    audit.note(AuditAction.SESSION_OPENED, audit.name, by=by)
    return secret


def issue(
    audit: AuditTrail, name: str, role: Role, expires_at: datetime | None
) -> tuple[Token, str]:
    """A new token and its secret, of which only the hash is stored.

    Raises Conflict: the name is taken, even if by a revoked token: reviews refer to it;
    Unprocessable: it would have expired already.
    """
    if expires_at is not None and expires_at <= utc_now():
        raise Unprocessable(f"expires_at {expires_at.isoformat()} is in the past")
    if Tokens(audit.session).by_name(name) is not None:
        raise Conflict(f"a token named {name!r} exists already; it may be revoked")
    secret = new_secret(TOKEN_PREFIX)
    token = Token(name=name, role=role, hash=hash_secret(secret), expires_at=expires_at)
    insert_row(audit.session, token)
    until = None if expires_at is None else rfc3339(expires_at)
    audit.note(
        AuditAction.TOKEN_CREATED, name, token_id=token.id, role=role, expires_at=until
    )
    return token, secret


def revoke(audit: AuditTrail, token_id: int) -> None:
    """Revoke a token, and end the sessions that it opened.

    Raises Conflict: it is the last valid token of an admin: nobody could make tokens
    afterwards.
    """
    tokens = Tokens(audit.session)
    token = existing(tokens.by_id(token_id), "token", token_id)
    now = utc_now()
    if tokens.valid_ids("admin", now) == [token_id]:
        raise Conflict(f"token {token.name!r} is the last one of an admin")
    if token.revoked_at is None:
        tokens.revoke(token, now)
        audit.note(AuditAction.TOKEN_REVOKED, token.name, token_id=token_id)


def make_code(audit: AuditTrail, token_id: int | None = None) -> tuple[LoginCode, str]:
    """A login code of this token, or of the actor's, and its secret.

    Raises Forbidden: the actor has a session: the session that the code opens would not
    end with it.
    """
    if audit.actor is not None and audit.actor.session_hash:
        raise Forbidden("a login code needs the token itself: a session makes none")
    secret, now = new_secret(LOGIN_CODE_PREFIX), utc_now()
    code = LoginCode(
        hash=hash_secret(secret),
        token_id=audit.token_id if token_id is None else token_id,
        expires_at=now + CODE_LIFETIME,
        created_at=now,
    )
    Tokens(audit.session).add_short_lived(code, most=MOST_CODES)
    audit.note(AuditAction.CODE_CREATED, code.id)
    return code, secret


def code_is_over(session: Session, code_id: int) -> bool:
    """Whether nobody can log in with this code any more."""
    code = Tokens(session).code(code_id)
    return code is None or code.used_at is not None or code.expires_at <= utc_now()


def own_code(session: Session, principal: Principal, code_id: int) -> LoginCode:
    """A login code of the caller's token; NotFound also if it is another token's."""
    code = Tokens(session).code(code_id)
    if code is None or code.token_id != principal.token_id:
        raise NotFound("login code", code_id)
    return code


def use_code(session: Session, code_id: int) -> None:
    """Mark a code as used; Unauthorised if it was used since `by_code` found it."""
    if not Tokens(session).use_code(code_id, utc_now()):
        raise _code_is_over()


def by_code(session: Session, secret: str) -> tuple[Principal, int]:
    """The caller that a login code logs in, and the code's id.

    Raises Unauthorised: the code is unknown, used or expired, or its token is no longer
    valid.
    """
    digest, now = hash_secret(secret), utc_now()
    tokens = Tokens(session)
    code = tokens.code_by_hash(digest)
    if code is None or code.used_at is not None or code.expires_at <= now:
        raise _code_is_over()
    token, connection = tokens.by_id(code.token_id), session.connection()
    is_same = same_hash(code.hash, digest)
    if token is None or not is_same or not is_valid(connection, token.id, None, now):
        raise _refused(token, now)
    return Principal(token.id, token.name, token.role), code.id


def make_link(session: Session, token_id: int, export_id: int) -> tuple[str, datetime]:
    """A key that downloads the file of one export, and when it expires."""
    key, now = new_secret(DOWNLOAD_PREFIX), utc_now()
    link = DownloadLink(
        hash=hash_secret(key),
        token_id=token_id,
        export_id=export_id,
        expires_at=now + LINK_LIFETIME,
        created_at=now,
    )
    Tokens(session).add_short_lived(link, most=MOST_LINKS)
    return key, link.expires_at


def check_link(session: Session, key: str, export_id: int) -> None:
    """Check that a key downloads the file of this export; Unauthorised if not."""
    if not Tokens(session).valid_by_link(hash_secret(key), export_id, utc_now()):
        raise Unauthorised(
            "this download link has expired, or belongs to another export: "
            "request a new one",
            code="link_over",
        )


def _refused(
    token: Token | TokenEnd | None,
    now: datetime,
    unknown: str = _NO_ENTRY,
    otherwise: str = "",
) -> Unauthorised:
    """The error for a token, or its session, that is not valid.

    `unknown` is its text, and `otherwise` its code, if the token has not ended itself.
    """
    if token is None:
        return Unauthorised(unknown)
    if token.revoked_at is not None:
        return Unauthorised(
            "this token was revoked; ask an admin for a new one", code="token_revoked"
        )
    if token.expires_at is not None and token.expires_at <= now:
        return Unauthorised(
            f"this token expired on {token.expires_at:%Y-%m-%d at %H:%M} UTC; "
            "ask an admin for another one",
            code="token_expired",
        )
    return Unauthorised(unknown, code=otherwise)


def _code_is_over() -> Unauthorised:
    return Unauthorised(
        "this login link was used already, or its ten minutes are over; "
        "`unghost login` prints a new one",
        code="code_over",
    )


def require_own(by: Principal, answers: Mapping[str, int], action: str) -> int:
    """Allow an action that removes answers to their author, and to admins.

    `answers` says how many would be deleted, undone or left behind, by reviewer, and
    `action`, with which the message begins, what is requested: ``deleting frame
    'a/1'``. Returns how many of these answers are other people's. Raises Forbidden:
    some are, and the caller is not an admin.
    """
    others = {name: number for name, number in answers.items() if name != by.name}
    number = sum(others.values())
    if number and not includes(by.role, "admin"):
        names = sorted(others)
        listed = ", ".join(names[:MOST_NAMED])
        if len(names) > MOST_NAMED:
            listed += f" and {len(names) - MOST_NAMED} more"
        raise Forbidden(
            f"{action} affects {number} {'answer' if number == 1 else 'answers'} of "
            f"{listed}: this needs the role admin, "
            f"token {by.name!r} has {by.role}",
            code="others_answers",
        )
    return number
