"""A dataset keeps the report of an experiment with its labels."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from app.db.migrate import refuse_to_lose

revision = "0020"
down_revision: str | None = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("datasets", sa.Column("experiment", sa.Text(), nullable=True))


def downgrade() -> None:
    refuse_to_lose("datasets", "experiment IS NOT NULL", what="experiments")
    op.drop_column("datasets", "experiment")
