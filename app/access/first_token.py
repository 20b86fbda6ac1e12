"""The token in the data folder, with which the command line of this machine logs in.

It expires after 30 days and is renewed after 15, at the start and while the service
runs. The former token stays valid until its own expiry, so that nobody who uses it is
interrupted.
"""

from __future__ import annotations

import os
import secrets
import stat
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final

from sqlalchemy.orm import Session

from app.access.audit import AuditAction, AuditTrail
from app.access.queries import Tokens
from app.access.service import MOST_SESSIONS, by_token, make_code
from app.db.base import rfc3339, utc_now
from app.db.tables.access import LoginCode, LoginSession, Token
from app.logs import server_log
from app.security import TOKEN_PREFIX, hash_secret, new_secret
from unghost.wire.words import Role

FIRST_TOKEN_NAME: Final = "admin"
LIFETIME: Final = timedelta(days=30)
RENEWED_BEFORE: Final = timedelta(days=15)
"""The token is renewed when it expires within this time."""
_PRIVATE: Final = 0o600
_OTHERS: Final = 0o077


def ensure_first_token(session: Session, file: Path) -> str:
    """The token in the file; a new one if there is none or it is not valid.

    To replace the token, delete the file and restart the service. A token that others
    could read is replaced too; that token and its sessions are then no longer valid.
    """
    tokens = Tokens(session)
    tokens.end_expired_sessions(utc_now())
    token = _read(file)
    was_shared = _make_private(file)
    row = _valid(session, token)
    if token and row is not None and not was_shared:
        return renew(session, file, row) if _is_due(row) else token
    return _replace(session, file)


def renew_first_token(session: Session, file: Path) -> None:
    """Renew the token in the file if it expires soon; a deleted file stays deleted."""
    row = _valid(session, _read(file))
    if row is not None and _is_due(row):
        renew(session, file, row)


def is_first_token_due(session: Session, file: Path) -> bool:
    """Whether `renew_first_token` has something to do."""
    row = _valid(session, _read(file))
    return row is not None and _is_due(row)


def make_first_code(session: Session, file: Path) -> tuple[LoginCode, str]:
    """A login code, and its secret, for the person who starts the service."""
    first = by_token(session, _read(file) or "")
    return make_code(AuditTrail(session), first.token_id)


def renew(session: Session, file: Path, row: Token) -> str:
    """Write a new token into the file; the former one keeps the expiry that it had."""
    token, ends = new_secret(TOKEN_PREFIX), utc_now() + LIFETIME
    # The file first: a hash whose token is lost would lock everybody out.
    write_secret(file, token)
    before, until = row.hash, row.expires_at or utc_now() + RENEWED_BEFORE
    row.hash, row.expires_at = hash_secret(token), ends
    # With its expiry as creation time it counts as the newest session of the token, so
    # that later sessions never displace it.
    former = LoginSession(
        token_id=row.id, hash=before, expires_at=until, created_at=until
    )
    Tokens(session).open_session(former, most=MOST_SESSIONS)
    AuditTrail(session).note(
        AuditAction.TOKEN_RENEWED, row.name, token_id=row.id, expires_at=rfc3339(ends)
    )
    return token


def write_secret(file: Path, text: str) -> None:
    """Write a file that others cannot read, not even while it is written."""
    draft = file.with_name(f".{file.name}.{secrets.token_hex(4)}")
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _PRIVATE)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text + "\n")
            stream.flush()
            os.fsync(stream.fileno())
        draft.replace(file)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def _replace(session: Session, file: Path) -> str:
    token, ends = new_secret(TOKEN_PREFIX), utc_now() + LIFETIME
    write_secret(file, token)
    role: Role = "admin"
    first = Tokens(session).replace(FIRST_TOKEN_NAME, role, hash_secret(token), ends)
    AuditTrail(session).note(
        AuditAction.TOKEN_CREATED,
        FIRST_TOKEN_NAME,
        token_id=first.id,
        role=role,
        expires_at=rfc3339(ends),
    )
    return token


def _valid(session: Session, token: str | None) -> Token | None:
    """The token with this secret, if it is valid."""
    digest = hash_secret(token or "")
    tokens = Tokens(session)
    found = tokens.valid_by_hash(digest, utc_now())
    return None if found is None else tokens.by_id(found.id)


def _is_due(row: Token) -> bool:
    """Whether the token is to be renewed; one that an operator put there never is."""
    if row.name != FIRST_TOKEN_NAME:
        return False
    return row.expires_at is None or _left(row.expires_at) < RENEWED_BEFORE


def _left(ends: datetime) -> timedelta:
    return ends - utc_now()


def _make_private(file: Path) -> bool:
    """Keep the file for its owner alone; True if others could read it until now.

    The file that a link leads to stays as it is: the new token replaces the link.
    """
    if os.name == "nt" or not file.exists():
        return False
    mode = stat.S_IMODE(file.stat().st_mode)
    if not mode & _OTHERS:
        return False
    if not file.is_symlink():
        file.chmod(_PRIVATE)
    server_log.warning(
        "the token file could be read by others (mode %o): its token is replaced, and "
        "only its owner can read the new one",
        mode,
    )
    return True


def _read(file: Path) -> str | None:
    try:
        return file.read_text(encoding="utf-8").strip()
    except FileNotFoundError:
        return None
