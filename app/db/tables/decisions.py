"""Tables of current decisions, derived from evidence, and of changes by runs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from sqlalchemy import CheckConstraint, Index, LargeBinary, SmallInteger, String, text
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Key, cascading

ONLY_SQLITE: Final = {"only": "sqlite"}
ONLY_POSTGRES: Final = {"only": "postgresql"}
_MATCH: Final = ("dataset_id", "class_id", "match_percent")


def _by_number(name: str, *columns: str, where: str = "") -> Iterator[Index]:
    """An index of boxes by a number and then by id, for each dialect.

    Many boxes have the same number, and pages of those are read by id. SQLite appends
    the row's key to each entry of an index; on PostgreSQL `box_id` has to be added.
    """
    on_sqlite = text(where.replace("true", "1")) if where else None
    yield Index(name, *columns, sqlite_where=on_sqlite, info=ONLY_SQLITE).ddl_if(
        dialect=ONLY_SQLITE["only"]
    )
    on_postgres = text(where) if where else None
    yield Index(
        f"{name}_and_box",
        *columns,
        "box_id",
        postgresql_where=on_postgres,
        info=ONLY_POSTGRES,
    ).ddl_if(dialect=ONLY_POSTGRES["only"])


class Decision(Base):
    """The current verdict of a box: derived, refreshed by uploads, runs and reviews.

    `match_percent`, `crowding` and the distances are copied from the evidence, `review`
    and `revision` from the latest review, because lists sort and filter by them.
    `distance_from` and `distance_to` are NULL where `distance` is not.
    `doubt` is what `filter_core.decisions.doubt` gives: which bin the box is in, and
    for boxes to ask about, how much an answer is worth.
    """

    __tablename__ = "decisions"
    __table_args__ = (
        CheckConstraint("reason between 1 and 17", name="reason"),
        CheckConstraint("review in ('keep', 'reject', 'unsure')", name="review"),
        Index("ix_decisions_by_reason", "dataset_id", "reason", "box_id"),
        Index("ix_decisions_by_class", "dataset_id", "class_id", "box_id"),
        *_by_number("ix_decisions_by_match", *_MATCH),
        *_by_number("ix_decisions_toss_up", *_MATCH, where="toss_up IS true"),
        Index(
            "ix_decisions_to_ask",
            *("dataset_id", "review", "doubt", "box_id"),
            # In the index only to filter by them without reading rows.
            *("class_id", "reason"),
            sqlite_where=text("doubt > 0"),
            postgresql_where=text("doubt > 0"),
        ),
        *_by_number("ix_decisions_by_crowding", "dataset_id", "crowding"),
        Index(
            "ix_decisions_reviewed",
            "dataset_id",
            "review",
            "box_id",
            sqlite_where=text("review IS NOT NULL"),
            postgresql_where=text("review IS NOT NULL"),
        ),
    )

    box_id: Mapped[int] = cascading("boxes.id", primary_key=True, autoincrement=False)
    dataset_id: Mapped[int] = mapped_column(Key)
    frame_id: Mapped[int] = mapped_column(Key, index=True)
    class_id: Mapped[int] = mapped_column(Key)
    match_percent: Mapped[float | None]
    crowding: Mapped[float]
    distance: Mapped[float | None]
    reason: Mapped[int] = mapped_column(SmallInteger)
    large: Mapped[bool]
    toss_up: Mapped[bool]
    doubt: Mapped[int] = mapped_column(SmallInteger, server_default=text("0"))
    review: Mapped[str | None] = mapped_column(String(8))
    revision: Mapped[int] = mapped_column(default=0)
    distance_from: Mapped[float | None]
    distance_to: Mapped[float | None]


class Tally(Base):
    """How many current decisions have the same values; statistics are sums of these."""

    __tablename__ = "tallies"

    dataset_id: Mapped[int] = cascading("datasets.id", primary_key=True)
    class_id: Mapped[int] = mapped_column(Key, primary_key=True)
    reason: Mapped[int] = mapped_column(SmallInteger, primary_key=True)
    toss_up: Mapped[bool] = mapped_column(primary_key=True)
    bin: Mapped[int] = mapped_column(
        SmallInteger, primary_key=True, server_default=text("0")
    )
    review: Mapped[str] = mapped_column(String(8), primary_key=True)
    boxes: Mapped[int] = mapped_column(Key)


class Flips(Base):
    """Boxes whose reason a run changed, thousands per row.

    `boxes` has one record (`FLIP` in `app/runs/queries.py`) per box, in order of id.
    """

    __tablename__ = "flips"

    run_id: Mapped[int] = cascading("runs.id", primary_key=True, autoincrement=False)
    first_box_id: Mapped[int] = mapped_column(
        Key, primary_key=True, autoincrement=False
    )
    last_box_id: Mapped[int] = mapped_column(Key)
    boxes: Mapped[bytes] = mapped_column(LargeBinary)
