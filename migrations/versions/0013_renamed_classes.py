"""Classes of a dataset can be renamed, merged and removed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from app.db.migrate import refuse_to_lose

revision = "0013"
down_revision: str | None = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column(
        "datasets",
        sa.Column("renamed_classes", sa.Text(), nullable=False, server_default="{}"),
    )
    op.add_column(
        "dataset_classes",
        sa.Column("listed", sa.Boolean(), nullable=False, server_default=sa.true()),
    )


def downgrade() -> None:
    refuse_to_lose("datasets", "renamed_classes <> '{}'", what="renamed classes")
    refuse_to_lose("dataset_classes", "NOT listed", what="which classes were removed")
    op.drop_column("dataset_classes", "listed")
    op.drop_column("datasets", "renamed_classes")
