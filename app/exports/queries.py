"""SQL of exports."""

from __future__ import annotations

from sqlalchemy.orm import Session

from app.db.pages import NewestPage, newest
from app.db.tables import Export
from app.errors import NotFound
from app.jobs.queries import find_job


class ExportRepository:
    """Rows of `exports`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def with_id(self, export_id: int) -> Export:
        """An export; NotFound, also if it was deleted with its dataset."""
        found = find_job(self._session, Export, export_id)
        if found is None:
            raise NotFound("export", export_id)
        return found

    def page(self, dataset_id: int, page: NewestPage) -> list[Export]:
        """Exports, newest first."""
        return newest(self._session, Export, dataset_id, page)
