"""SQL of versions, that is, of exports that have a name."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session, undefer

from app.db.base import existing
from app.db.pages import NewestPage
from app.db.tables import Dataset, Export


class VersionRepository:
    """Rows of `exports` that have a name."""

    def __init__(self, session: Session, dataset: Dataset) -> None:
        self._session, self._dataset_id = session, dataset.id

    def named(self, name: str) -> Export:
        """The version of this name; NotFound if there is none that is done."""
        of_name = Export.dataset_id == self._dataset_id, Export.name == name
        rows = select(Export).where(*of_name, Export.state == "done")
        version = self._session.scalar(rows.options(undefer(Export.frames_state)))
        return existing(version, "version", name)

    def export_of(self, name: str) -> int | None:
        """The export that has a name, or will have it when it is done."""
        of_name = Export.dataset_id == self._dataset_id, Export.name == name
        is_version = Export.state.not_in(("failed", "cancelled"))
        return self._session.scalar(select(Export.id).where(*of_name, is_version))

    def page(self, page: NewestPage) -> list[Export]:
        """The versions of a page, newest first, and one more if there is a next one."""
        rows = select(Export).where(
            Export.dataset_id == self._dataset_id, Export.name.is_not(None)
        )
        return list(self._session.scalars(page.of(rows, Export.id)))
