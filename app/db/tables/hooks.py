"""Tables of hooks, of what is delivered to them, and of datasets under review."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import Index, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, JsonText, Key, UtcDateTime, cascading, utc_now


class Hook(Base):
    """An address to which events are sent; without a dataset, those of all.

    The secret is stored as it is, since each delivery is signed with it.
    """

    __tablename__ = "hooks"
    __table_args__ = ({"sqlite_autoincrement": True},)

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    url: Mapped[str] = mapped_column(String(2000))
    events: Mapped[list[str]] = mapped_column(JsonText)
    dataset_id: Mapped[int | None] = cascading("datasets.id", index=True)
    secret: Mapped[str] = mapped_column(String(100))
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class HookDelivery(Base):
    """One event for one hook, and how far its delivery has come.

    `due_at` is null once it was delivered, or given up.
    """

    __tablename__ = "hook_deliveries"
    __table_args__ = (Index(None, "hook_id", "id"), {"sqlite_autoincrement": True})

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    hook_id: Mapped[int] = cascading("hooks.id")
    webhook_id: Mapped[str] = mapped_column(String(64))
    event: Mapped[str] = mapped_column(String(32))
    body: Mapped[str] = mapped_column(Text)
    attempts: Mapped[int] = mapped_column(default=0)
    answered: Mapped[int | None]
    """The status of the last response; null if there was none."""
    error: Mapped[str | None] = mapped_column(String(300))
    """Why the last attempt failed; null if it did not."""
    due_at: Mapped[datetime | None] = mapped_column(UtcDateTime, index=True)
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)
    finished_at: Mapped[datetime | None] = mapped_column(UtcDateTime)


class PendingReview(Base):
    """A dataset in whose queue boxes were seen that somebody has to review."""

    __tablename__ = "pending_reviews"

    dataset_id: Mapped[int] = cascading("datasets.id", primary_key=True)
