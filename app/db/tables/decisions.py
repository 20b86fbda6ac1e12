"""Current decisions, derived from evidence, and what runs changed in them."""

from __future__ import annotations

from sqlalchemy import (
    CheckConstraint,
    ForeignKey,
    Index,
    LargeBinary,
    SmallInteger,
    String,
    text,
)
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Key


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
        Index(
            "ix_decisions_unanswered",
            "dataset_id",
            "class_id",
            "match_percent",
            sqlite_where=text("review IS NULL"),
            postgresql_where=text("review IS NULL"),
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
