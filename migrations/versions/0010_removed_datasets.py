"""Datasets that were deleted, and whose rows go part by part."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision: str | None = "0009"
branch_labels = None
depends_on = None

COLUMN = sa.Column("removed_at", sa.DateTime(timezone=True), nullable=True)


def upgrade() -> None:
    op.add_column("datasets", COLUMN)


def downgrade() -> None:
    left = "SELECT count(*) FROM datasets WHERE removed_at IS NOT NULL"
    if op.get_bind().execute(sa.text(left)).scalar_one():
        # Earlier versions would show them again, with what is left of them.
        raise RuntimeError(
            "datasets that were deleted are not gone yet: serve the folder with this "
            "version until they are, then go back"
        )
    op.drop_column("datasets", "removed_at")
