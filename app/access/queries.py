"""SQL of tokens, their sessions, login codes and download links, and the audit log."""

from __future__ import annotations

from datetime import datetime
from typing import Final, NamedTuple, TypeAlias

from sqlalchemy import Connection, Row, bindparam, delete, func, or_, select, update

from app.db.base import Repository, insert_row
from app.db.pages import NewestPage
from app.db.tables.access import (
    AuditEntry,
    DownloadLink,
    LoginCode,
    LoginSession,
    Token,
)
from app.security import Principal
from unghost.wire.words import Role

_NEWEST: Final = 1000


class AuditRepository(Repository):
    """The audit log of one database session."""

    def noted_since(self, token_id: int, action: str, since: datetime) -> int:
        """How many entries of a token about this action are younger than `since`.

        Only the newest entries are counted: `_NEWEST` of all tokens and actions.
        """
        newest = (
            select(AuditEntry.token_id, AuditEntry.action, AuditEntry.created_at)
            .order_by(AuditEntry.id.desc())
            .limit(_NEWEST)
            .subquery()
        )
        count = select(func.count()).where(
            newest.c.token_id == token_id,
            newest.c.action == action,
            newest.c.created_at > since,
        )
        return self._session.scalar(count) or 0

    def page(self, page: NewestPage) -> list[AuditEntry]:
        """Entries, newest first; one more than the limit if there is a next page."""
        return list(self._session.scalars(page.of(select(AuditEntry), AuditEntry.id)))


_VALID: Final = (
    Token.revoked_at.is_(None),
    or_(Token.expires_at.is_(None), Token.expires_at > bindparam("now")),
)
# Built once: every request runs one of them.
_BY_HASH: Final = (
    select(Token.id, Token.name, Token.role, Token.hash)
    .where(Token.hash == bindparam("digest"), *_VALID)
    .order_by(Token.id)
)
_BY_SESSION: Final = (
    select(Token.id, Token.name, Token.role, LoginSession.hash)
    .join(LoginSession, LoginSession.token_id == Token.id)
    .where(
        LoginSession.hash == bindparam("digest"),
        LoginSession.expires_at > bindparam("now"),
        *_VALID,
    )
    .order_by(Token.id)
)
_VALID_ID: Final = (
    select(Token.id)
    .where(Token.id == bindparam("token_id"), *_VALID)
    .order_by(Token.id)
)
_VALID_SESSION: Final = _BY_SESSION.where(Token.id == bindparam("token_id"))


def is_valid(
    connection: Connection, token_id: int, session_digest: str | None, now: datetime
) -> bool:
    """Whether a token is valid, and its session with this hash, if there is one."""
    values = {"token_id": token_id, "now": now, "digest": session_digest}
    statement = _VALID_ID if session_digest is None else _VALID_SESSION
    return connection.execute(statement, values).first() is not None


TokenEnd: TypeAlias = Row[datetime | None, datetime | None]
"""When a token was revoked, and when it expires; None: never."""


def end_of(connection: Connection, token_id: int) -> TokenEnd | None:
    """The end of a token, valid or not; None if there is no such token."""
    statement = select(Token.revoked_at, Token.expires_at).where(Token.id == token_id)
    return connection.execute(statement).first()


class TokenRow(NamedTuple):
    """A token that is valid now."""

    id: int
    name: str
    role: Role
    hash: str


class Tokens(Repository):
    """Tokens and sessions of one database session."""

    def valid_by_hash(self, digest: str, now: datetime) -> TokenRow | None:
        """The token with this hash, unless it is revoked or has expired."""
        row = self._session.execute(_BY_HASH, {"digest": digest, "now": now}).first()
        return TokenRow(*row) if row else None

    def valid_by_session(self, digest: str, now: datetime) -> TokenRow | None:
        """The token that opened this session, if both are still valid."""
        row = self._session.execute(_BY_SESSION, {"digest": digest, "now": now}).first()
        return TokenRow(*row) if row else None

    def replace(self, name: str, role: Role, digest: str) -> Token:
        """Give the token of this name a new hash; what the former one opened ends."""
        token = self.by_name(name)
        if token is None:
            token = Token(name=name, role=role, hash=digest)
            return insert_row(self._session, token)
        self._end_all_of(token.id)
        token.hash, token.role = digest, role
        token.revoked_at = token.expires_at = None
        self._session.flush()
        return token

    def note_use(self, token_id: int, at: datetime) -> None:
        """Store when a token was last used, unless a later time is stored already."""
        earlier = or_(Token.last_used_at.is_(None), Token.last_used_at < at)
        self._session.execute(
            update(Token)
            .where(Token.id == token_id, earlier)
            .values(last_used_at=at)
            .execution_options(synchronize_session=False)
        )

    def by_id(self, token_id: int) -> Token | None:
        """The token, valid or not."""
        return self._session.get(Token, token_id)

    def by_hash(self, digest: str) -> Token | None:
        """The token with this hash, valid or not."""
        return self._session.scalar(select(Token).where(Token.hash == digest))

    def by_session_hash(self, digest: str) -> Token | None:
        """The token that opened the session with this hash; either may be invalid."""
        tokens = select(Token).join(LoginSession, LoginSession.token_id == Token.id)
        return self._session.scalar(tokens.where(LoginSession.hash == digest))

    def by_name(self, name: str) -> Token | None:
        """The token of this name, valid or not."""
        return self._session.scalar(select(Token).where(Token.name == name))

    def page(self, *, after_id: int, limit: int) -> list[Token]:
        """The next tokens by id."""
        tokens = select(Token).where(Token.id > after_id).order_by(Token.id)
        return list(self._session.scalars(tokens.limit(limit)))

    def valid_ids(self, role: Role, now: datetime) -> list[int]:
        """Tokens of a role that may be used."""
        statement = (
            select(Token.id).where(Token.role == role, *_VALID).order_by(Token.id)
        )
        return list(self._session.scalars(statement, {"now": now}))

    def revoke(self, token: Token, now: datetime) -> None:
        """Make the token invalid permanently; a second call changes nothing."""
        token.revoked_at = token.revoked_at or now
        self._end_all_of(token.id)
        self._session.flush()

    def open_session(self, opened: LoginSession, *, most: int) -> None:
        """Store a session that a token opened; only its `most` newest sessions stay."""
        self._keep_newest(insert_row(self._session, opened), most)

    def expiry(self, of: Principal) -> datetime | None:
        """When a caller's token or session expires, whichever is first; None: never."""
        token = select(Token.expires_at).where(Token.id == of.token_id)
        ends = [self._session.scalar(token)]
        if of.session_hash is not None:
            session = select(LoginSession.expires_at)
            its_own = session.where(LoginSession.hash == of.session_hash)
            ends.append(self._session.scalar(its_own))
        return min((end for end in ends if end is not None), default=None)

    def add_short_lived(self, row: LoginCode | DownloadLink, *, most: int) -> None:
        """Store a login code or download link.

        Rows of the same kind that have expired, and the token's oldest above `most`,
        are deleted.
        """
        table = type(row)
        ended = delete(table).where(table.expires_at <= row.created_at)
        self._session.execute(ended)
        self._keep_newest(insert_row(self._session, row), most)

    def code(self, code_id: int) -> LoginCode | None:
        """The login code with this id, used or not."""
        return self._session.get(LoginCode, code_id)

    def code_by_hash(self, digest: str) -> LoginCode | None:
        """The login code with this hash, used or not."""
        return self._session.scalar(select(LoginCode).where(LoginCode.hash == digest))

    def use_code(self, code_id: int, now: datetime) -> bool:
        """Mark a login code as used; False if it was used already or has expired."""
        noted = self._session.execute(
            update(LoginCode)
            .where(
                LoginCode.id == code_id,
                LoginCode.used_at.is_(None),
                LoginCode.expires_at > now,
            )
            .values(used_at=now)
            .returning(LoginCode.id)
        )
        return noted.first() is not None

    def valid_by_link(self, digest: str, export_id: int, now: datetime) -> bool:
        """Whether this link opens this export, and its token is still valid."""
        row = self._session.execute(
            select(Token.id)
            .join(DownloadLink, DownloadLink.token_id == Token.id)
            .where(
                DownloadLink.hash == digest,
                DownloadLink.export_id == export_id,
                DownloadLink.expires_at > bindparam("now"),
                *_VALID,
            )
            .order_by(Token.id),
            {"now": now},
        )
        return row.first() is not None

    def _keep_newest(
        self, added: LoginSession | LoginCode | DownloadLink, most: int
    ) -> None:
        """Delete the oldest rows of a token, but not the one that was just added."""
        table = type(added)
        is_its_own = table.token_id == added.token_id
        newest = (
            select(table.hash)
            .where(is_its_own)
            .order_by(table.created_at.desc(), table.hash)
            .limit(most)
        )
        is_older = table.hash.not_in(newest.scalar_subquery())
        # If the clock was set back, the newest row looks old.
        self._session.execute(
            delete(table).where(is_its_own, is_older, table.hash != added.hash)
        )

    def end_session(self, digest: str) -> None:
        self._session.execute(delete(LoginSession).where(LoginSession.hash == digest))

    def _end_all_of(self, token_id: int) -> None:
        """Delete the sessions, login codes and download links of a token."""
        for table in (LoginSession, LoginCode, DownloadLink):
            self._session.execute(delete(table).where(table.token_id == token_id))

    def end_expired_sessions(self, now: datetime) -> None:
        self._session.execute(
            delete(LoginSession).where(LoginSession.expires_at <= now)
        )
