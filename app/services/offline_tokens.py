"""Tokens for who can reach the database but has none to ask the service with."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import exc as sql

from app.db.access_tables import Token
from app.security import Role
from app.services.audit import AuditTrail
from app.services.data_folder import CannotMaintain, opened
from app.services.tokens import issue
from app.settings import Settings


def issue_offline(
    settings: Settings, name: str, role: Role, expires_at: datetime | None
) -> tuple[Token, str]:
    """A new token and what to show for it; the audit log names the service itself.

    Raises
    ------
    CannotMaintain
        The database is not there, or at another schema.
    Conflict
        The name is taken.
    """
    try:
        with opened(settings) as database, database.write() as session:
            return issue(AuditTrail(session), name, role, expires_at)
    except sql.OperationalError as exc:
        raise CannotMaintain(
            f"the database does not take it: {exc.orig}; `unghost doctor` says more"
        ) from exc
