"""Tables of people's answers, which are insert-only, and of claims on boxes."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import CheckConstraint, Index, String, Text, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Key, UtcDateTime, cascading, utc_now


class ReviewBatch(Base):
    """A bulk answer: many answers given at once.

    `looked_at` is how many of the boxes the person had on the screen before, where the
    client says so.
    """

    __tablename__ = "review_batches"
    __table_args__ = ({"sqlite_autoincrement": True},)

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    dataset_id: Mapped[int] = cascading("datasets.id")
    verdict: Mapped[str] = mapped_column(String(8))
    undoes_id: Mapped[int | None] = mapped_column(Key)
    reviewer: Mapped[str] = mapped_column(String(100))
    looked_at: Mapped[int | None] = mapped_column()
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)


class Review(Base):
    """A person's answer on one box; rows are never changed, later answers follow.

    An answer that undoes another one has that one's revision in `undoes`, and repeats
    the verdict and the comment from before it. One that came from a file has the name
    of who imported it in `imported_by`; its reviewer and its time are those of the
    file. `looked_ms` is for how many milliseconds the person had the box and its
    picture on the screen before the answer, where the client says so.
    file. `chosen_by`, `chosen_from` and `probability` say how the queue chose the box,
    as its claim did; they are None if the queue did not.
    """

    __tablename__ = "reviews"
    __table_args__ = (
        UniqueConstraint("box_id", "revision"),
        CheckConstraint(
            "verdict in ('keep', 'reject', 'unsure', 'clear')", name="verdict"
        ),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[int] = mapped_column(Key, primary_key=True)
    box_id: Mapped[int] = cascading("boxes.id")
    revision: Mapped[int]
    verdict: Mapped[str] = mapped_column(String(8))
    comment: Mapped[str] = mapped_column(Text, default="")
    reviewer: Mapped[str] = mapped_column(String(100))
    undoes: Mapped[int | None]
    carried_from: Mapped[int | None] = mapped_column(Key)
    batch_id: Mapped[int | None] = cascading("review_batches.id", index=True)
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, default=utc_now)
    imported_by: Mapped[str | None] = mapped_column(String(100))
    looked_ms: Mapped[int | None]
    chosen_by: Mapped[str | None] = mapped_column(String(8))
    chosen_from: Mapped[str | None] = mapped_column(Text)
    probability: Mapped[float | None]


class Claim(Base):
    """A box reserved for one reviewer by the queue, until the claim expires.

    `chosen_by` is the order of the queue, `chosen_from` its filters as JSON, and
    `probability`, in a random order, that of being among the boxes up to this one.
    """

    __tablename__ = "claims"
    __table_args__ = (Index(None, "dataset_id", "expires_at"),)

    box_id: Mapped[int] = cascading("boxes.id", primary_key=True, autoincrement=False)
    dataset_id: Mapped[int] = cascading("datasets.id")
    reviewer: Mapped[str] = mapped_column(String(100))
    expires_at: Mapped[datetime] = mapped_column(UtcDateTime)
    chosen_by: Mapped[str | None] = mapped_column(String(8))
    chosen_from: Mapped[str | None] = mapped_column(Text)
    probability: Mapped[float | None]
