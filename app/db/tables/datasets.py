"""Tables of datasets, their classes, configurations and measurements."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import String, Text, UniqueConstraint, false, text
from sqlalchemy.orm import Mapped, column_property, mapped_column

from app.db.base import Base, JsonText, Key, UtcDateTime, cascading, utc_now
from filter_core.decisions.doubt import DOUBT_VERSION


class Dataset(Base):
    """A set of frames, and the settings for reading their segmentations."""

    __tablename__ = "datasets"
    __table_args__ = ({"sqlite_autoincrement": True},)

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    name: Mapped[str] = mapped_column(String(100), unique=True)
    description: Mapped[str] = mapped_column(Text, default="")
    rule: Mapped[str] = mapped_column(Text, default="", server_default=text("''"))
    """By which rule people keep boxes, shown beside each question."""
    coached: Mapped[bool] = mapped_column(default=False, server_default=false())
    """Whether the queue begins with boxes whose truth it tells."""
    palette: Mapped[str] = mapped_column(String(32), default="auto")
    encoding: Mapped[str] = mapped_column(String(16), default="auto")
    channel_order: Mapped[str] = mapped_column(String(8), default="auto")
    lossy_segmentation: Mapped[str] = mapped_column(String(16), default="refuse")
    # Deferred: a mask may be megabytes, and few uses of a dataset need it.
    ignore_mask: Mapped[dict[str, object] | None] = mapped_column(
        JsonText, deferred=True
    )
    has_ignore_mask: Mapped[bool] = column_property(ignore_mask.is_not(None))
    recording: Mapped[dict[str, object] | None] = mapped_column(JsonText)
    """The description by which the folder of its frames is read."""
    experiment: Mapped[dict[str, object] | None] = mapped_column(
        JsonText, deferred=True
    )
    """The last report of ``unghost worth-it`` about its frames."""
    active_config_id: Mapped[int | None] = mapped_column(Key)
    active_run_id: Mapped[int | None] = mapped_column(Key)
    active_measurement_id: Mapped[int | None] = mapped_column(Key)
    renamed_classes: Mapped[dict[str, str]] = mapped_column(JsonText, default=dict)
    """What a class is called now, by the name that boxes come with."""
    doubt_version: Mapped[int] = mapped_column(
        default=DOUBT_VERSION, server_default=text("0")
    )
    """The `DOUBT_VERSION` by which the doubt about its boxes was computed."""
    classes_frozen_at: Mapped[datetime | None] = mapped_column(UtcDateTime)
    removed_at: Mapped[datetime | None] = mapped_column(UtcDateTime)
    """When it was deleted: it is hidden, and its rows are deleted in small steps."""
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class DatasetClass(Base):
    """A class of a dataset; `position` gives the order of the classes in exports.

    A class that was merged into another one, renamed or removed is not `listed` any
    more. Its row stays, because earlier revisions of frames and earlier measurements
    refer to it. Nor is a class yet that a run is going to create by renaming another.
    """

    __tablename__ = "dataset_classes"
    __table_args__ = (
        UniqueConstraint("dataset_id", "name"),
        UniqueConstraint("dataset_id", "position"),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = cascading("datasets.id")
    position: Mapped[int]
    name: Mapped[str] = mapped_column(String(200))
    listed: Mapped[bool] = mapped_column(default=True)
    came_with_frame: Mapped[bool] = mapped_column(default=False)
    """Whether only boxes have named it: it is not listed when no box has it any more,
    and its row may become that of another class."""


class ConfigVersion(Base):
    """One immutable filter configuration of a dataset, identified by its digest."""

    __tablename__ = "config_versions"
    __table_args__ = (
        UniqueConstraint("dataset_id", "digest"),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = cascading("datasets.id")
    digest: Mapped[str] = mapped_column(String(64), index=True)
    body: Mapped[dict[str, object]] = mapped_column(JsonText)
    unused_keys: Mapped[list[str]] = mapped_column(JsonText)
    created_by: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class Measurement(Base):
    """The options with which pixels are measured; evidence compares within one."""

    __tablename__ = "measurements"
    __table_args__ = (
        UniqueConstraint("dataset_id", "digest"),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = cascading("datasets.id")
    digest: Mapped[str] = mapped_column(String(64))
    pixel_digest: Mapped[str] = mapped_column(String(64))
    # Deferred: the dataset's ignore mask is part of it.
    options: Mapped[dict[str, Any]] = mapped_column(JsonText, deferred=True)
    filter_core_version: Mapped[str] = mapped_column(String(32))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)
