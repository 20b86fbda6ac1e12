"""Tables of frames, their files and boxes, and their evidence."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, Index, LargeBinary, String, UniqueConstraint, text
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, JsonText, Key, UtcDateTime, cascading, utc_now

CODE_POINTS = String(512).with_variant(String(512, collation="C"), "postgresql")
"""Sorted by code point, so that pages and prefixes of keys are ranges of an index."""


class Blob(Base):
    """A file in the storage, identified by the hash of its content."""

    __tablename__ = "blobs"

    sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    size_bytes: Mapped[int] = mapped_column(Key)
    media_type: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class Frame(Base):
    """One revision of a frame; its boxes have the ids from `first_box_id` on."""

    __tablename__ = "frames"
    __table_args__ = (
        UniqueConstraint("dataset_id", "key", "revision"),
        Index(
            "uq_frames_current_key",
            "dataset_id",
            "key",
            unique=True,
            sqlite_where=text("superseded_at IS NULL"),
            postgresql_where=text("superseded_at IS NULL"),
        ),
        Index(None, "dataset_id", "id"),
        Index(
            "ix_frames_by_place",
            *("dataset_id", "sequence", "camera", "map", "id"),
            sqlite_where=text("superseded_at IS NULL"),
            postgresql_where=text("superseded_at IS NULL"),
        ),
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = cascading("datasets.id")
    key: Mapped[str] = mapped_column(CODE_POINTS)
    revision: Mapped[int] = mapped_column(default=1)
    superseded_at: Mapped[datetime | None] = mapped_column(UtcDateTime)
    content_digest: Mapped[str] = mapped_column(String(64))
    config_id: Mapped[int] = mapped_column(Key)
    run_id: Mapped[int] = mapped_column(Key)
    first_box_id: Mapped[int] = mapped_column(Key)
    box_count: Mapped[int]
    # Never NULL, although the columns allow it: a frame of unknown size is refused.
    width: Mapped[int] = mapped_column(nullable=True)
    height: Mapped[int] = mapped_column(nullable=True)
    carla_version: Mapped[str | None] = mapped_column(String(200))
    map: Mapped[str | None] = mapped_column(String(200))
    captured_at: Mapped[str | None] = mapped_column(String(64))
    annotation: Mapped[dict[str, Any]] = mapped_column(JsonText, deferred=True)
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)
    camera: Mapped[str | None] = mapped_column(String(256))
    """The name of the camera, as the annotation says; as is the drive."""
    sequence: Mapped[str | None] = mapped_column(String(256))
    weather: Mapped[str | None] = mapped_column(String(256))
    """The preset of the annotation's weather; ``other`` without one."""


class FrameFile(Base):
    """Which blob is a frame's image, segmentation, depth and so on."""

    __tablename__ = "frame_files"

    frame_id: Mapped[int] = cascading("frames.id", primary_key=True)
    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    sha256: Mapped[str] = mapped_column(
        String(64), ForeignKey("blobs.sha256"), index=True
    )


class Box(Base):
    """One annotated box of one frame revision."""

    __tablename__ = "boxes"

    id: Mapped[int] = mapped_column(Key, primary_key=True, autoincrement=False)
    frame_id: Mapped[int] = cascading("frames.id", index=True)
    class_id: Mapped[int] = cascading("dataset_classes.id")
    source_id: Mapped[str] = mapped_column(String(200))


class FrameEvidence(Base):
    """The numbers of one frame's boxes as packed columns (`app.measuring.evidence`)."""

    __tablename__ = "evidence"
    __table_args__ = (
        UniqueConstraint("frame_id", "measurement_id"),
        Index(
            "ix_evidence_lossy",
            "measurement_id",
            sqlite_where=text("lossy IS 1"),
            postgresql_where=text("lossy IS true"),
        ),
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    frame_id: Mapped[int] = cascading("frames.id")
    measurement_id: Mapped[int] = cascading("measurements.id", index=True)
    numbers: Mapped[bytes] = mapped_column(LargeBinary)
    tag_counts: Mapped[bytes] = mapped_column(LargeBinary)
    geometry: Mapped[bytes] = mapped_column(LargeBinary)
    channels: Mapped[bytes | None] = mapped_column(LargeBinary)
    segmentation: Mapped[Any | None] = mapped_column(JsonText)
    lossy: Mapped[bool]


class IdBlock(Base):
    """The next free id of frames or boxes; ids are reserved in blocks, never reused."""

    __tablename__ = "id_blocks"

    name: Mapped[str] = mapped_column(String(16), primary_key=True)
    next_id: Mapped[int] = mapped_column(Key)


class Problem(Base):
    """A frame that was refused, with the error its sender got."""

    __tablename__ = "problems"
    __table_args__ = (Index(None, "dataset_id", "id"), {"sqlite_autoincrement": True})

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = cascading("datasets.id")
    key: Mapped[str] = mapped_column(String(512))
    error: Mapped[dict[str, object]] = mapped_column(JsonText)
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)
