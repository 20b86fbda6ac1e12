"""The tables. Insert-only but for `decisions` and `tallies`, which are derived."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import (
    CheckConstraint,
    ForeignKey,
    Index,
    LargeBinary,
    SmallInteger,
    String,
    Text,
    UniqueConstraint,
    text,
)
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, JsonText, Key, UtcDateTime, utc_now


class Dataset(Base):
    """Frames that belong together, and how their segmentations are to be read."""

    __tablename__ = "datasets"

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    name: Mapped[str] = mapped_column(String(100), unique=True)
    description: Mapped[str] = mapped_column(Text, default="")
    palette: Mapped[str] = mapped_column(String(32), default="auto")
    encoding: Mapped[str] = mapped_column(String(16), default="auto")
    channel_order: Mapped[str] = mapped_column(String(8), default="auto")
    lossy_segmentation: Mapped[str] = mapped_column(String(16), default="refuse")
    ignore_mask: Mapped[Any | None] = mapped_column(JsonText)
    active_config_id: Mapped[int | None] = mapped_column(Key)
    active_run_id: Mapped[int | None] = mapped_column(Key)
    active_measurement_id: Mapped[int | None] = mapped_column(Key)
    classes_frozen_at: Mapped[datetime | None] = mapped_column(UtcDateTime)
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class DatasetClass(Base):
    """A class of a dataset; `position` is its index in every export."""

    __tablename__ = "dataset_classes"
    __table_args__ = (
        UniqueConstraint("dataset_id", "name"),
        UniqueConstraint("dataset_id", "position"),
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = mapped_column(
        Key, ForeignKey("datasets.id", ondelete="CASCADE")
    )
    position: Mapped[int]
    name: Mapped[str] = mapped_column(String(200))


class ConfigVersion(Base):
    """One immutable filter configuration of a dataset, named by its digest."""

    __tablename__ = "config_versions"
    __table_args__ = (UniqueConstraint("dataset_id", "digest"),)

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = mapped_column(
        Key, ForeignKey("datasets.id", ondelete="CASCADE")
    )
    digest: Mapped[str] = mapped_column(String(64), index=True)
    body: Mapped[Any] = mapped_column(JsonText)
    unused_keys: Mapped[Any] = mapped_column(JsonText)
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class Measurement(Base):
    """What pixels were measured with; evidence of one measurement is comparable."""

    __tablename__ = "measurements"
    __table_args__ = (UniqueConstraint("dataset_id", "digest"),)

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = mapped_column(
        Key, ForeignKey("datasets.id", ondelete="CASCADE")
    )
    digest: Mapped[str] = mapped_column(String(64))
    pixel_digest: Mapped[str] = mapped_column(String(64))
    options: Mapped[Any] = mapped_column(JsonText)
    filter_core_version: Mapped[str] = mapped_column(String(32))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class Run(Base):
    """One config version applied to a dataset."""

    __tablename__ = "runs"
    __table_args__ = (
        CheckConstraint("kind in ('decide', 'measure')", name="kind"),
        CheckConstraint(
            "state in ('queued', 'running', 'done', 'failed', 'cancelled')",
            name="state",
        ),
        Index(None, "dataset_id", "id"),
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = mapped_column(
        Key, ForeignKey("datasets.id", ondelete="CASCADE")
    )
    config_id: Mapped[int] = mapped_column(
        Key, ForeignKey("config_versions.id", ondelete="CASCADE")
    )
    measurement_id: Mapped[int | None] = mapped_column(
        Key, ForeignKey("measurements.id", ondelete="CASCADE")
    )
    previous_run_id: Mapped[int | None] = mapped_column(Key)
    kind: Mapped[str] = mapped_column(String(16))
    state: Mapped[str] = mapped_column(String(16), default="queued")
    activate: Mapped[bool] = mapped_column(default=False)
    total: Mapped[int] = mapped_column(Key, default=0)
    done: Mapped[int] = mapped_column(Key, default=0)
    changed: Mapped[int] = mapped_column(Key, default=0)
    counts: Mapped[Any] = mapped_column(JsonText, default=dict)
    error: Mapped[Any | None] = mapped_column(JsonText)
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)
    started_at: Mapped[datetime | None] = mapped_column(UtcDateTime)
    finished_at: Mapped[datetime | None] = mapped_column(UtcDateTime)


class Blob(Base):
    """A file in the store, named by its content."""

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
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = mapped_column(
        Key, ForeignKey("datasets.id", ondelete="CASCADE")
    )
    key: Mapped[str] = mapped_column(String(512))
    revision: Mapped[int] = mapped_column(default=1)
    superseded_at: Mapped[datetime | None] = mapped_column(UtcDateTime)
    content_digest: Mapped[str] = mapped_column(String(64))
    config_id: Mapped[int] = mapped_column(Key)
    run_id: Mapped[int] = mapped_column(Key)
    first_box_id: Mapped[int] = mapped_column(Key)
    box_count: Mapped[int]
    width: Mapped[int | None]
    height: Mapped[int | None]
    carla_version: Mapped[str | None] = mapped_column(String(32))
    map: Mapped[str | None] = mapped_column(String(200))
    captured_at: Mapped[str | None] = mapped_column(String(64))
    annotation: Mapped[Any] = mapped_column(JsonText, deferred=True)
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class FrameFile(Base):
    """Which blob is a frame's image, segmentation, depth and so on."""

    __tablename__ = "frame_files"

    frame_id: Mapped[int] = mapped_column(
        Key, ForeignKey("frames.id", ondelete="CASCADE"), primary_key=True
    )
    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    sha256: Mapped[str] = mapped_column(
        String(64), ForeignKey("blobs.sha256"), index=True
    )


class Box(Base):
    """One annotated box of one frame revision."""

    __tablename__ = "boxes"

    id: Mapped[int] = mapped_column(Key, primary_key=True, autoincrement=False)
    frame_id: Mapped[int] = mapped_column(
        Key, ForeignKey("frames.id", ondelete="CASCADE"), index=True
    )
    class_id: Mapped[int] = mapped_column(
        Key, ForeignKey("dataset_classes.id", ondelete="CASCADE")
    )
    source_id: Mapped[str] = mapped_column(String(200))


class FrameEvidence(Base):
    """The numbers of one frame's boxes as packed columns; see `evidence_record`."""

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
    frame_id: Mapped[int] = mapped_column(
        Key, ForeignKey("frames.id", ondelete="CASCADE")
    )
    measurement_id: Mapped[int] = mapped_column(
        Key, ForeignKey("measurements.id", ondelete="CASCADE"), index=True
    )
    numbers: Mapped[bytes] = mapped_column(LargeBinary)
    tag_counts: Mapped[bytes] = mapped_column(LargeBinary)
    geometry: Mapped[bytes] = mapped_column(LargeBinary)
    segmentation: Mapped[Any | None] = mapped_column(JsonText)
    lossy: Mapped[bool]


class Decision(Base):
    """The current verdict of a box: derived, refreshed by uploads, runs and reviews.

    `match_percent`, `crowding` and `distance` are copied from the evidence, `review`
    and `revision` from the latest review, because lists sort and filter by them.
    """

    __tablename__ = "decisions"
    __table_args__ = (
        CheckConstraint("reason between 1 and 14", name="reason"),
        CheckConstraint("review in ('keep', 'reject', 'unsure')", name="review"),
        Index("ix_decisions_by_reason", "dataset_id", "reason", "box_id"),
        Index("ix_decisions_by_class", "dataset_id", "class_id", "box_id"),
        Index("ix_decisions_by_match", "dataset_id", "class_id", "match_percent"),
        Index(
            "ix_decisions_toss_up",
            "dataset_id",
            "class_id",
            "match_percent",
            sqlite_where=text("toss_up IS 1"),
            postgresql_where=text("toss_up IS true"),
        ),
        Index(
            "ix_decisions_large",
            "dataset_id",
            "class_id",
            "match_percent",
            sqlite_where=text("large IS 1"),
            postgresql_where=text("large IS true"),
        ),
        Index("ix_decisions_by_crowding", "dataset_id", "crowding"),
        Index(
            "ix_decisions_reviewed",
            "dataset_id",
            "review",
            "box_id",
            sqlite_where=text("review IS NOT NULL"),
            postgresql_where=text("review IS NOT NULL"),
        ),
    )

    box_id: Mapped[int] = mapped_column(
        Key,
        ForeignKey("boxes.id", ondelete="CASCADE"),
        primary_key=True,
        autoincrement=False,
    )
    dataset_id: Mapped[int] = mapped_column(Key)
    frame_id: Mapped[int] = mapped_column(Key, index=True)
    class_id: Mapped[int] = mapped_column(Key)
    match_percent: Mapped[float | None]
    crowding: Mapped[float]
    distance: Mapped[float | None]
    reason: Mapped[int] = mapped_column(SmallInteger)
    large: Mapped[bool]
    toss_up: Mapped[bool]
    review: Mapped[str | None] = mapped_column(String(8))
    revision: Mapped[int] = mapped_column(default=0)


class Tally(Base):
    """How many current decisions are alike: what statistics are summed from."""

    __tablename__ = "tallies"

    dataset_id: Mapped[int] = mapped_column(
        Key, ForeignKey("datasets.id", ondelete="CASCADE"), primary_key=True
    )
    class_id: Mapped[int] = mapped_column(Key, primary_key=True)
    reason: Mapped[int] = mapped_column(SmallInteger, primary_key=True)
    toss_up: Mapped[bool] = mapped_column(primary_key=True)
    review: Mapped[str] = mapped_column(String(8), primary_key=True)
    boxes: Mapped[int] = mapped_column(Key)


class Flips(Base):
    """Boxes whose reason a run changed, thousands to a row; see `flip_record`."""

    __tablename__ = "flips"

    run_id: Mapped[int] = mapped_column(
        Key,
        ForeignKey("runs.id", ondelete="CASCADE"),
        primary_key=True,
        autoincrement=False,
    )
    first_box_id: Mapped[int] = mapped_column(
        Key, primary_key=True, autoincrement=False
    )
    last_box_id: Mapped[int] = mapped_column(Key)
    boxes: Mapped[bytes] = mapped_column(LargeBinary)


class ReviewBatch(Base):
    """Many answers given in one act."""

    __tablename__ = "review_batches"

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = mapped_column(
        Key, ForeignKey("datasets.id", ondelete="CASCADE")
    )
    verdict: Mapped[str] = mapped_column(String(8))
    undoes_id: Mapped[int | None] = mapped_column(Key)
    reviewer: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class Review(Base):
    """A person's answer on one box; never changed, only followed by another."""

    __tablename__ = "reviews"
    __table_args__ = (
        UniqueConstraint("box_id", "revision"),
        CheckConstraint(
            "verdict in ('keep', 'reject', 'unsure', 'clear')", name="verdict"
        ),
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    box_id: Mapped[int] = mapped_column(Key, ForeignKey("boxes.id", ondelete="CASCADE"))
    revision: Mapped[int]
    verdict: Mapped[str] = mapped_column(String(8))
    comment: Mapped[str] = mapped_column(Text, default="")
    reviewer: Mapped[str] = mapped_column(String(100))
    carried_from: Mapped[int | None] = mapped_column(Key)
    batch_id: Mapped[int | None] = mapped_column(
        Key, ForeignKey("review_batches.id", ondelete="CASCADE"), index=True
    )
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class Problem(Base):
    """A frame that was refused, with the error its sender got."""

    __tablename__ = "problems"
    __table_args__ = (Index(None, "dataset_id", "id"),)

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
            "state in ('queued', 'running', 'done', 'failed')", name="state"
        ),
        Index(None, "dataset_id", "id"),
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = mapped_column(
        Key, ForeignKey("datasets.id", ondelete="CASCADE")
    )
    format: Mapped[str] = mapped_column(String(32))
    options: Mapped[Any] = mapped_column(JsonText)
    state: Mapped[str] = mapped_column(String(16), default="queued")
    run_id: Mapped[int | None] = mapped_column(Key)
    sha256: Mapped[str | None] = mapped_column(String(64))
    size_bytes: Mapped[int | None] = mapped_column(Key)
    media_type: Mapped[str | None] = mapped_column(String(64))
    counts: Mapped[Any | None] = mapped_column(JsonText)
    error: Mapped[Any | None] = mapped_column(JsonText)
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)
    finished_at: Mapped[datetime | None] = mapped_column(UtcDateTime)


class IdBlock(Base):
    """The next free id of frames and boxes, handed out in blocks, never twice."""

    __tablename__ = "id_blocks"

    name: Mapped[str] = mapped_column(String(16), primary_key=True)
    next_id: Mapped[int] = mapped_column(Key)
