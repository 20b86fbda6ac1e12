"""Codes of login links, addresses of downloads, and when a token was last used.

Sessions end with it: each was a cookie, which a browser shows to every port of a host.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision: str | None = "0007"
branch_labels = None
depends_on = None

KEY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    op.execute("DELETE FROM login_sessions")
    op.add_column("tokens", sa.Column("last_used_at", TIME, nullable=True))
    op.create_table(
        "login_codes",
        sa.Column("id", KEY, nullable=False),
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("token_id", KEY, nullable=False),
        sa.Column("expires_at", TIME, nullable=False),
        sa.Column("used_at", TIME, nullable=True),
        sa.Column("created_at", TIME, nullable=False),
        _of_token("login_codes"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_login_codes")),
        sa.UniqueConstraint("hash", name=op.f("uq_login_codes_hash")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_login_codes_token_id"), "login_codes", ["token_id"])
    op.create_table(
        "download_links",
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("token_id", KEY, nullable=False),
        sa.Column("export_id", KEY, nullable=False),
        sa.Column("expires_at", TIME, nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        _of_token("download_links"),
        sa.ForeignKeyConstraint(
            ["export_id"],
            ["exports.id"],
            name=op.f("fk_download_links_export_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("hash", name=op.f("pk_download_links")),
    )
    for column in ("token_id", "export_id"):
        op.create_index(op.f(f"ix_download_links_{column}"), "download_links", [column])


def downgrade() -> None:
    op.drop_table("download_links")
    op.drop_table("login_codes")
    op.drop_column("tokens", "last_used_at")
    # Their secrets are no cookies: they open nothing in the version before. Nothing is
    # asked: whoever has a token signs in again, and tokens and the audit log stay.
    op.execute("DELETE FROM login_sessions")


def _of_token(table: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(
        ["token_id"],
        ["tokens.id"],
        name=op.f(f"fk_{table}_token_id"),
        ondelete="CASCADE",
    )
