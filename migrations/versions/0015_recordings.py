"""A dataset keeps how the folder of its frames is read."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from app.db.migrate import refuse_to_lose

revision = "0015"
down_revision: str | None = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("datasets", sa.Column("recording", sa.Text(), nullable=True))


def downgrade() -> None:
    refuse_to_lose("datasets", "recording IS NOT NULL", what="how folders are read")
    op.drop_column("datasets", "recording")
