"""Exports say how far they are, and can be cancelled."""

from __future__ import annotations

from contextlib import AbstractContextManager

import sqlalchemy as sa
from alembic import op
from alembic.operations import BatchOperations

revision = "0002"
down_revision: str | None = "0001"
branch_labels = None
depends_on = None

KEY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
STATES = ("queued", "running", "done", "failed")


def upgrade() -> None:
    with _exports() as exports:
        exports.add_column(sa.Column("done", KEY, nullable=False, server_default="0"))
        exports.add_column(sa.Column("total", KEY, nullable=False, server_default="0"))
    _allow(*STATES, "cancelled")


def downgrade() -> None:
    op.execute("UPDATE exports SET state = 'failed' WHERE state = 'cancelled'")
    _allow(*STATES)
    with _exports() as exports:
        exports.drop_column("total")
        exports.drop_column("done")


def _allow(*states: str) -> None:
    wanted = ", ".join(f"'{state}'" for state in states)
    with _exports() as exports:
        exports.drop_constraint(op.f("ck_exports_state"), type_="check")
        exports.create_check_constraint(
            op.f("ck_exports_state"), f"state in ({wanted})"
        )


def _exports() -> AbstractContextManager[BatchOperations]:
    # SQLite makes the table anew; its numbers must not begin again with it.
    return op.batch_alter_table("exports", table_kwargs={"sqlite_autoincrement": True})
