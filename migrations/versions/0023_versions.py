"""Exports may have a name, by which they are kept, and a digest of what they hold."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from app.db.migrate import refuse_to_lose

revision = "0023"
down_revision: str | None = "0022"
branch_labels = None
depends_on = None

_COLUMNS = (
    ("name", sa.String(100)),
    ("since", sa.String(100)),
    ("version", sa.String(64)),
    ("frames_state", sa.LargeBinary()),
)


def upgrade() -> None:
    for name, kind in _COLUMNS:
        op.add_column("exports", sa.Column(name, kind, nullable=True))
    op.create_index(
        op.f("ix_exports_dataset_id_name"), "exports", ["dataset_id", "name"]
    )


def downgrade() -> None:
    refuse_to_lose("exports", "name IS NOT NULL", what="the names of versions")
    op.drop_index(op.f("ix_exports_dataset_id_name"), "exports")
    for name, _ in _COLUMNS:
        op.drop_column("exports", name)
