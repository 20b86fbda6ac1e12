"""What the queue needs: claims, and an index of the boxes that nobody answered."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision: str | None = "0002"
branch_labels = None
depends_on = None

KEY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    op.create_table(
        "claims",
        sa.Column("box_id", KEY, autoincrement=False, nullable=False),
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("reviewer", sa.String(length=100), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["box_id"],
            ["boxes.id"],
            name=op.f("fk_claims_box_id"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_claims_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("box_id", name=op.f("pk_claims")),
    )
    op.create_index(
        op.f("ix_claims_dataset_id_expires_at"),
        "claims",
        ["dataset_id", "expires_at"],
        unique=False,
    )
    op.create_index(
        "ix_decisions_unanswered",
        "decisions",
        ["dataset_id", "class_id", "match_percent"],
        unique=False,
        sqlite_where=sa.text("review IS NULL"),
        postgresql_where=sa.text("review IS NULL"),
    )


def downgrade() -> None:
    op.drop_index(
        "ix_decisions_unanswered",
        table_name="decisions",
        sqlite_where=sa.text("review IS NULL"),
        postgresql_where=sa.text("review IS NULL"),
    )
    op.drop_index(op.f("ix_claims_dataset_id_expires_at"), table_name="claims")
    op.drop_table("claims")
