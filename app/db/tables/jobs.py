"""Who carries out which run or export, and which parts of it are done."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import CheckConstraint, String
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, JsonText, Key, UtcDateTime


class Chunk(Base):
    """A part of a job: frames from one id to another that lacked their numbers.

    An export is one chunk, and so is the decision that ends a run; their ids are 0, and
    so is the number of a decision. `attempts` counts the processes in a row that
    ended while they worked on it; where the driver itself does, also the one that does.
    """

    __tablename__ = "chunks"
    __table_args__ = (
        CheckConstraint("kind in ('run', 'export')", name="kind"),
        CheckConstraint("state in ('waiting', 'done', 'quarantined')", name="state"),
    )

    kind: Mapped[str] = mapped_column(String(8), primary_key=True)
    job_id: Mapped[int] = mapped_column(Key, primary_key=True, autoincrement=False)
    number: Mapped[int] = mapped_column(Key, primary_key=True, autoincrement=False)
    first_frame_id: Mapped[int] = mapped_column(Key)
    last_frame_id: Mapped[int] = mapped_column(Key)
    frames: Mapped[int] = mapped_column(Key)
    state: Mapped[str] = mapped_column(String(16), default="waiting")
    attempts: Mapped[int] = mapped_column(default=0)
    error: Mapped[Any | None] = mapped_column(JsonText)
    finished_at: Mapped[datetime | None] = mapped_column(UtcDateTime)


class Lease(Base):
    """The process that drives a job, until when unless it says so again."""

    __tablename__ = "leases"

    kind: Mapped[str] = mapped_column(String(8), primary_key=True)
    job_id: Mapped[int] = mapped_column(Key, primary_key=True, autoincrement=False)
    holder: Mapped[str] = mapped_column(String(200))
    until: Mapped[datetime] = mapped_column(UtcDateTime)


class Installation(Base):
    """One row: what tells this database from every other one."""

    __tablename__ = "installation"

    id: Mapped[str] = mapped_column(String(36), primary_key=True)
