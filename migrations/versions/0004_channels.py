"""What channels besides the segmentation measure, packed as the other numbers are."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision: str | None = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("evidence", sa.Column("channels", sa.LargeBinary(), nullable=True))


def downgrade() -> None:
    op.drop_column("evidence", "channels")
