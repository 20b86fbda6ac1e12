"""Tables of runs and exports, of their chunks, and of the leases on them."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import ClassVar

from sqlalchemy import CheckConstraint, Index, LargeBinary, String
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, JsonText, Key, UtcDateTime, cascading, utc_now


class Chunk(Base):
    """A part of a job: a range of frame ids, planned for frames that lack evidence.

    An export is one chunk, and so is the final step of a run (deciding): both have 0
    instead of frame ids, and the final step has the number 0.
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
    """How many processes have died while they worked on the chunk, since a result of it
    was stored. While a driver works on the chunk itself, it is counted as well
    (`app.jobs.attempts`)."""
    error: Mapped[dict[str, object] | None] = mapped_column(JsonText)
    finished_at: Mapped[datetime | None] = mapped_column(UtcDateTime)


class Lease(Base):
    """The process that drives a job, and when its lease expires unless it is renewed.

    `holder` is empty if the process has left the job unfinished.
    """

    __tablename__ = "leases"

    kind: Mapped[str] = mapped_column(String(8), primary_key=True)
    job_id: Mapped[int] = mapped_column(Key, primary_key=True, autoincrement=False)
    holder: Mapped[str] = mapped_column(String(200))
    until: Mapped[datetime] = mapped_column(UtcDateTime)


class Installation(Base):
    """A single row, with the unique id of this database."""

    __tablename__ = "installation"

    id: Mapped[str] = mapped_column(String(36), primary_key=True)


class JobRow:
    """The columns that all kinds of jobs share: author, progress and outcome.

    `created_by` is the token's name; `total` and `done` count frames.
    """

    job_kind: ClassVar[str]
    """The name of the kind in `chunks` and `leases`."""

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = cascading("datasets.id")
    state: Mapped[str] = mapped_column(String(16), default="queued")
    total: Mapped[int] = mapped_column(Key, default=0)
    done: Mapped[int] = mapped_column(Key, default=0)
    error: Mapped[dict[str, object] | None] = mapped_column(JsonText)
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)
    finished_at: Mapped[datetime | None] = mapped_column(UtcDateTime)


class Run(JobRow, Base):
    """One config version applied to a dataset."""

    job_kind = "run"

    __tablename__ = "runs"
    __table_args__ = (
        CheckConstraint("kind in ('decide', 'measure')", name="kind"),
        CheckConstraint(
            "state in ('queued', 'running', 'done', 'failed', 'cancelled')",
            name="state",
        ),
        Index(None, "dataset_id", "id"),
        {"sqlite_autoincrement": True},
    )

    config_id: Mapped[int] = cascading("config_versions.id")
    measurement_id: Mapped[int | None] = cascading("measurements.id")
    previous_run_id: Mapped[int | None] = mapped_column(Key)
    kind: Mapped[str] = mapped_column(String(16))
    """Whether it measures, or only decides; not the kind of job (`job_kind`)."""
    activate: Mapped[bool] = mapped_column(default=False)
    changed: Mapped[int] = mapped_column(Key, default=0)
    counts: Mapped[dict[str, int]] = mapped_column(JsonText, default=dict)
    started_at: Mapped[datetime | None] = mapped_column(UtcDateTime)
    last_review_id: Mapped[int | None] = mapped_column(Key)
    """The newest answer when it was done; None for runs of earlier versions."""


class Export(JobRow, Base):
    """Labels written in one format from one state of a dataset."""

    job_kind = "export"

    __tablename__ = "exports"
    __table_args__ = (
        CheckConstraint(
            "state in ('queued', 'running', 'done', 'failed', 'cancelled')",
            name="state",
        ),
        Index(None, "dataset_id", "id"),
        Index(None, "dataset_id", "name"),
        {"sqlite_autoincrement": True},
    )

    format: Mapped[str] = mapped_column(String(32))
    options: Mapped[dict[str, object]] = mapped_column(JsonText)
    run_id: Mapped[int | None] = mapped_column(Key)
    sha256: Mapped[str | None] = mapped_column(String(64))
    size_bytes: Mapped[int | None] = mapped_column(Key)
    media_type: Mapped[str | None] = mapped_column(String(64))
    counts: Mapped[Mapping[str, object] | None] = mapped_column(JsonText)
    name: Mapped[str | None] = mapped_column(String(100))
    """Of a version: its file is kept until somebody deletes it."""
    since: Mapped[str | None] = mapped_column(String(100))
    """The version whose frames are left out, unless they have changed since."""
    version: Mapped[str | None] = mapped_column(String(64))
    """Digest of all frames, their decisions and answers, and the configuration."""
    frames_state: Mapped[bytes | None] = mapped_column(LargeBinary, deferred=True)
    """The digest of each frame of a version, compressed."""
