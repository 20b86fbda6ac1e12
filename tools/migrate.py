"""Migrates the database of the data folder to the newest schema, without serving."""

from __future__ import annotations

from app.db.migrate import current_revision
from app.process.lifespan import running
from app.settings import Settings


def main() -> None:
    """Open the data folder as the service does, and print the schema's revision."""
    settings = Settings()
    with running(settings) as services:
        print(f"{settings.data}: schema {current_revision(services.database.engine)}")


if __name__ == "__main__":
    main()
