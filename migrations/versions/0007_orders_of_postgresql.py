"""What PostgreSQL has to be told of orders, and SQLite does of itself.

Keys of frames are in the order of their characters, whatever the database's language
is. Indexes by numbers end with the box's id.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision: str | None = "0006"
branch_labels = None
depends_on = None

MATCH = ("dataset_id", "class_id", "match_percent")
INDEXES: dict[str, tuple[tuple[str, ...], str | None]] = {
    "ix_decisions_by_match": (MATCH, None),
    "ix_decisions_toss_up": (MATCH, "toss_up IS true"),
    "ix_decisions_large": (MATCH, "large IS true"),
    "ix_decisions_unanswered": (MATCH, "review IS NULL"),
    "ix_decisions_by_crowding": (("dataset_id", "crowding"), None),
}


def upgrade() -> None:
    if op.get_bind().dialect.name != "postgresql":
        return
    _collate("C")
    for name, (columns, where) in INDEXES.items():
        op.drop_index(name, table_name="decisions")
        _create(f"{name}_and_box", (*columns, "box_id"), where)


def downgrade() -> None:
    if op.get_bind().dialect.name != "postgresql":
        return
    for name, (columns, where) in INDEXES.items():
        op.drop_index(f"{name}_and_box", table_name="decisions")
        _create(name, columns, where)
    _collate("default")


def _create(name: str, columns: tuple[str, ...], where: str | None) -> None:
    condition = None if where is None else sa.text(where)
    op.create_index(name, "decisions", columns, postgresql_where=condition)


def _collate(name: str) -> None:
    # A column that a view shows cannot be changed: the view goes and comes back.
    view = sa.text("SELECT pg_get_viewdef('readable_decisions'::regclass)")
    definition = op.get_bind().execute(view).scalar_one()
    op.execute("DROP VIEW readable_decisions")
    op.execute(
        f'ALTER TABLE frames ALTER COLUMN key TYPE VARCHAR(512) COLLATE "{name}"'
    )
    op.execute(f"CREATE VIEW readable_decisions AS {definition}")
