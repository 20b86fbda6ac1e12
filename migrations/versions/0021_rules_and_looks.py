"""A dataset has a rule of what to keep; bulk answers say how many boxes were seen."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision: str | None = "0020"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column(
        "datasets", sa.Column("rule", sa.Text(), nullable=False, server_default="")
    )
    op.add_column("review_batches", sa.Column("looked_at", sa.Integer()))


def downgrade() -> None:
    op.drop_column("review_batches", "looked_at")
    op.drop_column("datasets", "rule")
