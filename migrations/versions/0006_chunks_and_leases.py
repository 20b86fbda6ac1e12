"""Parts of jobs, who carries a job out, and what tells one database from another."""

from __future__ import annotations

import uuid

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision: str | None = "0005"
branch_labels = None
depends_on = None

KEY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    op.create_table(
        "chunks",
        sa.Column("kind", sa.String(length=8), nullable=False),
        sa.Column("job_id", KEY, autoincrement=False, nullable=False),
        sa.Column("number", KEY, autoincrement=False, nullable=False),
        sa.Column("first_frame_id", KEY, nullable=False),
        sa.Column("last_frame_id", KEY, nullable=False),
        sa.Column("frames", KEY, nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("error", sa.Text(), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("kind in ('run', 'export')", name=op.f("ck_chunks_kind")),
        sa.CheckConstraint(
            "state in ('waiting', 'done', 'quarantined')", name=op.f("ck_chunks_state")
        ),
        sa.PrimaryKeyConstraint("kind", "job_id", "number", name=op.f("pk_chunks")),
    )
    op.create_table(
        "leases",
        sa.Column("kind", sa.String(length=8), nullable=False),
        sa.Column("job_id", KEY, autoincrement=False, nullable=False),
        sa.Column("holder", sa.String(length=200), nullable=False),
        sa.Column("until", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("kind", "job_id", name=op.f("pk_leases")),
    )
    installation = op.create_table(
        "installation",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_installation")),
    )
    op.bulk_insert(installation, [{"id": str(uuid.uuid4())}])


def downgrade() -> None:
    op.drop_table("installation")
    op.drop_table("leases")
    op.drop_table("chunks")
