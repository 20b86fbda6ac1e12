"""Alembic's entry: runs migrations on the connection that it is given."""

from __future__ import annotations

from alembic import context
from sqlalchemy import Connection

from app.db.base import Base


def run(connection: Connection) -> None:
    """Migrate inside the caller's transaction."""
    context.configure(
        connection=connection,
        target_metadata=Base.metadata,
        render_as_batch=connection.dialect.name == "sqlite",
        compare_type=True,
    )
    with context.begin_transaction():
        context.run_migrations()


run(context.config.attributes["connection"])
