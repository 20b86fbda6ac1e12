"""For how long a person looked at a box before the answer."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("reviews", sa.Column("looked_ms", sa.Integer(), nullable=True))


def downgrade() -> None:
    op.drop_column("reviews", "looked_ms")
