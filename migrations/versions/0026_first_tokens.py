"""The first token lasts until it is replaced: those that exist lose their end."""

from __future__ import annotations

from alembic import op

revision = "0026"
down_revision: str | None = "0023"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.execute(
        "UPDATE tokens SET expires_at = NULL"
        " WHERE name = 'admin' AND revoked_at IS NULL"
    )


def downgrade() -> None:
    """Nothing to do: an earlier version renews a token without an end."""
