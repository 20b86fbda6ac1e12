"""Writes the audit log, in the transactions of the actions that it records."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta
from enum import Enum
from typing import Final

from sqlalchemy.orm import Session

from app.access.queries import AuditRepository
from app.db.base import insert_row, utc_now
from app.db.tables.access import AuditEntry
from app.security import Principal

SERVICE: Final = "unghost"
"""The actor of actions of the service itself; their entries have no token."""


class AuditAction(str, Enum):
    """Actions that are recorded. The values are stored, so none changes its meaning."""

    TOKEN_CREATED = "token.created"
    TOKEN_REVOKED = "token.revoked"
    CODE_CREATED = "login_code.created"
    SESSION_OPENED = "session.opened"
    DATASET_CREATED = "dataset.created"
    DATASET_CHANGED = "dataset.changed"
    DATASET_DELETED = "dataset.deleted"
    FRAME_REPLACED = "frame.replaced"
    FRAME_DELETED = "frame.deleted"
    ANSWERS_GIVEN = "review_batch.created"
    ANSWERS_UNDONE = "review_batch.undone"
    ANSWER_UNDONE = "review.undone"
    ANSWER_CLEARED = "review.cleared"
    ANSWERS_IMPORTED = "reviews.imported"
    CONFIG_ACTIVATED = "config.activated"
    RUN_CANCELLED = "run.cancelled"
    EXPORT_CREATED = "export.created"
    EXPORT_CANCELLED = "export.cancelled"
    EXPORT_DELETED = "export.deleted"
    HOOK_CREATED = "hook.created"
    HOOK_DELETED = "hook.deleted"


OFTEN: Final = (AuditAction.CODE_CREATED, AuditAction.SESSION_OPENED)
MOST_AN_HOUR: Final = 100


@dataclass(frozen=True)
class AuditTrail:
    """Adds entries to the audit log in one transaction, for one actor.

    An action and its entry are committed together, or neither is. In a route
    (`Audited`), `session` is the `WriteSession` of the request.
    """

    session: Session
    actor: Principal | None = None

    @property
    def token_id(self) -> int:
        """The token of the actor; ValueError if that is the service itself."""
        if self.actor is None:
            raise ValueError("the service itself has no token")
        return self.actor.token_id

    @property
    def name(self) -> str:
        return SERVICE if self.actor is None else self.actor.name

    def note(self, action: AuditAction, subject: object, **details: object) -> None:
        """Add an entry; `subject` is the name or id of what the action affected.

        Of `OFTEN`, actions that everybody may repeat as often as they like, the log has
        at most `MOST_AN_HOUR` of each token and action: no entry is ever deleted.
        """
        if self.actor is not None and action in OFTEN:
            since = utc_now() - timedelta(hours=1)
            token_id = self.actor.token_id
            log = AuditRepository(self.session)
            if log.noted_since(token_id, action.value, since) >= MOST_AN_HOUR:
                return
        insert_row(
            self.session,
            AuditEntry(
                token_id=None if self.actor is None else self.actor.token_id,
                actor=self.name,
                action=action.value,
                subject=str(subject),
                details=details,
            ),
        )
