"""How the queue chose the box of a claim, and so of an answer."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for table in ("claims", "reviews"):
        op.add_column(table, sa.Column("chosen_by", sa.String(8), nullable=True))
        op.add_column(table, sa.Column("chosen_from", sa.Text(), nullable=True))
        op.add_column(table, sa.Column("probability", sa.Double(), nullable=True))


def downgrade() -> None:
    for table in ("claims", "reviews"):
        for name in ("chosen_by", "chosen_from", "probability"):
            op.drop_column(table, name)
