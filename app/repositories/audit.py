"""Rows of `audit_log`: added and read, never changed."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.access_tables import AuditEntry
from app.repositories.newest import NewestPage


class AuditRepository:
    """The audit log of one database session."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def add(self, entry: AuditEntry) -> None:
        """Insert."""
        self._session.add(entry)
        self._session.flush()

    def page(self, page: NewestPage) -> list[AuditEntry]:
        """Entries, newest first, and one more than asked for if there is one."""
        rows = select(AuditEntry)
        if page.before_id is not None:
            rows = rows.where(AuditEntry.id < page.before_id)
        rows = rows.order_by(AuditEntry.id.desc()).limit(page.limit + 1)
        return list(self._session.scalars(rows))
