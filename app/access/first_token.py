"""The token in the data folder, with which the command line of this machine logs in."""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path
from typing import Final

from sqlalchemy.orm import Session

from app.access.audit import AuditAction, AuditTrail
from app.access.queries import Tokens
from app.access.service import by_token, make_code
from app.db.base import utc_now
from app.db.tables.access import LoginCode
from app.logs import server_log
from app.security import TOKEN_PREFIX, hash_secret, new_secret
from unghost.wire.words import Role

FIRST_TOKEN_NAME: Final = "admin"
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
    if token and not was_shared and tokens.valid_by_hash(hash_secret(token), utc_now()):
        return token
    # The file first: a hash whose token is lost would lock everybody out.
    token = new_secret(TOKEN_PREFIX)
    write_secret(file, token)
    role: Role = "admin"
    first = tokens.replace(FIRST_TOKEN_NAME, role, hash_secret(token))
    AuditTrail(session).note(
        AuditAction.TOKEN_CREATED, FIRST_TOKEN_NAME, token_id=first.id, role=role
    )
    return token


def make_first_code(session: Session, file: Path) -> tuple[LoginCode, str]:
    """A login code, and its secret, for the person who starts the service."""
    first = by_token(session, _read(file) or "")
    return make_code(AuditTrail(session), first.token_id)


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
