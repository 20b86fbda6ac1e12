"""Answers that an administrator imported from a file."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("reviews", sa.Column("imported_by", sa.String(100), nullable=True))


def downgrade() -> None:
    op.drop_column("reviews", "imported_by")
