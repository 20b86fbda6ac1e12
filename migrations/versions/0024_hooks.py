"""Hooks are told when a run or an export ends, or a dataset has been reviewed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from app.db.migrate import refuse_to_lose

revision = "0024"
down_revision: str | None = "0023"
branch_labels = None
depends_on = None

KEY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    op.create_table(
        "hooks",
        sa.Column("id", KEY, nullable=False),
        sa.Column("url", sa.String(length=2000), nullable=False),
        sa.Column("events", sa.Text(), nullable=False),
        sa.Column("dataset_id", KEY, nullable=True),
        sa.Column("secret", sa.String(length=100), nullable=False),
        sa.Column("created_by", sa.String(length=100), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        _parent("hooks", "dataset_id", "datasets.id"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_hooks")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_hooks_dataset_id"), "hooks", ["dataset_id"])
    op.create_table(
        "hook_deliveries",
        sa.Column("id", KEY, nullable=False),
        sa.Column("hook_id", KEY, nullable=False),
        sa.Column("webhook_id", sa.String(length=64), nullable=False),
        sa.Column("event", sa.String(length=32), nullable=False),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("answered", sa.Integer(), nullable=True),
        sa.Column("error", sa.String(length=300), nullable=True),
        sa.Column("due_at", TIME, nullable=True),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("finished_at", TIME, nullable=True),
        _parent("hook_deliveries", "hook_id", "hooks.id"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_hook_deliveries")),
        sqlite_autoincrement=True,
    )
    for columns in (["hook_id", "id"], ["due_at"]):
        name = op.f(f"ix_hook_deliveries_{'_'.join(columns)}")
        op.create_index(name, "hook_deliveries", columns)
    op.create_table(
        "pending_reviews",
        sa.Column("dataset_id", KEY, nullable=False),
        _parent("pending_reviews", "dataset_id", "datasets.id"),
        sa.PrimaryKeyConstraint("dataset_id", name=op.f("pk_pending_reviews")),
    )


def downgrade() -> None:
    refuse_to_lose("hooks")
    op.drop_table("pending_reviews")
    op.drop_table("hook_deliveries")
    op.drop_table("hooks")


def _parent(table: str, column: str, other: str) -> sa.ForeignKeyConstraint:
    name = op.f(f"fk_{table}_{column}")
    return sa.ForeignKeyConstraint([column], [other], name=name, ondelete="CASCADE")
