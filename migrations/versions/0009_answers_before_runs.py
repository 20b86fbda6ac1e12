"""Runs know the answers that were given before they ended: no clock says that."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision: str | None = "0008"
branch_labels = None
depends_on = None

KEY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    op.add_column("runs", sa.Column("last_review_id", KEY, nullable=True))


def downgrade() -> None:
    op.drop_column("runs", "last_review_id")
