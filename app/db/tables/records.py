"""Frames that were refused, and labels that were written."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import (
    CheckConstraint,
    ForeignKey,
    Index,
    String,
)
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, JsonText, Key, UtcDateTime, utc_now


class Problem(Base):
    """A frame that was refused, with the error its sender got."""

    __tablename__ = "problems"
    __table_args__ = (
        Index(None, "dataset_id", "id"),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = mapped_column(
        Key, ForeignKey("datasets.id", ondelete="CASCADE")
    )
    key: Mapped[str] = mapped_column(String(512))
    error: Mapped[Any] = mapped_column(JsonText)
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class Export(Base):
    """Labels written in one format from one state of a dataset."""

    __tablename__ = "exports"
    __table_args__ = (
        CheckConstraint(
            "state in ('queued', 'running', 'done', 'failed', 'cancelled')",
            name="state",
        ),
        Index(None, "dataset_id", "id"),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = mapped_column(
        Key, ForeignKey("datasets.id", ondelete="CASCADE")
    )
    format: Mapped[str] = mapped_column(String(32))
    options: Mapped[Any] = mapped_column(JsonText)
    state: Mapped[str] = mapped_column(String(16), default="queued")
    run_id: Mapped[int | None] = mapped_column(Key)
    total: Mapped[int] = mapped_column(Key, default=0)
    done: Mapped[int] = mapped_column(Key, default=0)
    sha256: Mapped[str | None] = mapped_column(String(64))
    size_bytes: Mapped[int | None] = mapped_column(Key)
    media_type: Mapped[str | None] = mapped_column(String(64))
    counts: Mapped[Any | None] = mapped_column(JsonText)
    error: Mapped[Any | None] = mapped_column(JsonText)
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)
    finished_at: Mapped[datetime | None] = mapped_column(UtcDateTime)
