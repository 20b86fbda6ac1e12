"""The audit log: acts that others must know of, in the transactions that do them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

from sqlalchemy.orm import Session

from app.access.queries import AuditRepository
from app.db.tables.access import AuditEntry
from app.security import Principal

SERVICE: Final = "unghost"
"""The actor of what the service did by itself; such an entry has no token."""


class Act(str, Enum):
    """What is noted. A value, once used, keeps its meaning."""

    TOKEN_CREATED = "token.created"
    TOKEN_REVOKED = "token.revoked"
    TOKEN_RENEWED = "token.renewed"
    CODE_CREATED = "login_code.created"
    SESSION_OPENED = "session.opened"
    DATASET_CREATED = "dataset.created"
    DATASET_CHANGED = "dataset.changed"
    DATASET_DELETED = "dataset.deleted"
    FRAME_REPLACED = "frame.replaced"
    FRAME_DELETED = "frame.deleted"
    ANSWERS_GIVEN = "review_batch.created"
    ANSWERS_TAKEN_BACK = "review_batch.undone"
    CONFIG_ACTIVATED = "config.activated"
    RUN_CANCELLED = "run.cancelled"
    EXPORT_CREATED = "export.created"
    EXPORT_CANCELLED = "export.cancelled"


@dataclass(frozen=True)
class AuditTrail:
    """Where one transaction notes what is done in it, and by whom.

    No entry without the act, and no act without the entry: both are committed, or
    neither is.
    """

    session: Session
    actor: Principal | None = None

    @property
    def token_id(self) -> int:
        """The token of who acts; ValueError if it is the service itself."""
        if self.actor is None:
            raise ValueError("the service acts without a token")
        return self.actor.token_id

    @property
    def name(self) -> str:
        """Who acts."""
        return SERVICE if self.actor is None else self.actor.name

    def note(self, act: Act, subject: object, **details: object) -> None:
        """Add an entry; `subject` is the name or number of what it was done to."""
        AuditRepository(self.session).add(
            AuditEntry(
                token_id=None if self.actor is None else self.actor.token_id,
                actor=self.name,
                action=act.value,
                subject=str(subject),
                details=details,
            )
        )
