"""Config versions, runs, exports and problems: what happened to a dataset."""

from __future__ import annotations

from sqlalchemy import insert, select
from sqlalchemy.orm import Session

from app.db.bulk import NewestPage, newest
from app.db.flip_record import BOXES_PER_ROW, find_flip, pack_flips
from app.db.tables import Export, Flips, Run
from app.errors import NotFound
from app.jobs.queries import OPEN, find_job
from filter_core.types import IntArray


class RunRepository:
    """Rows of `runs`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def add(self, run: Run) -> Run:
        """Insert."""
        self._session.add(run)
        self._session.flush()
        return run

    def find(self, run_id: int) -> Run | None:
        """A run, unless it was deleted with its dataset."""
        return find_job(self._session, Run, run_id)

    def with_id(self, run_id: int) -> Run:
        """A run; NotFound."""
        found = self.find(run_id)
        if found is None:
            raise NotFound("run", run_id)
        return found

    def page(self, dataset_id: int, page: NewestPage) -> list[Run]:
        """Runs, newest first."""
        return newest(self._session, Run, dataset_id, page)

    def last_to_activate(self, dataset_id: int) -> Run | None:
        """The open run after which no other one will change what is active."""
        rows = select(Run).where(
            Run.dataset_id == dataset_id,
            Run.state.in_(OPEN),
            Run.activate.is_(True),
        )
        return self._session.scalar(rows.order_by(Run.id.desc()).limit(1))

    def has_to_wait(self, run: Run) -> bool:
        """Whether an earlier run of the dataset is to become active before this one.

        Each was asked for as a change of what those before it will have made active.
        """
        if not run.activate:
            return False
        rows = select(Run.id).where(
            Run.dataset_id == run.dataset_id,
            Run.state.in_(OPEN),
            Run.activate.is_(True),
            Run.id < run.id,
        )
        return self._session.scalar(rows.limit(1)) is not None

    def that_flipped(self, dataset_id: int, box_id: int) -> list[Run]:
        """Runs that changed a box, oldest first."""
        rows = (
            select(Run, Flips.boxes)
            .join(Flips, Flips.run_id == Run.id)
            .where(
                Run.dataset_id == dataset_id,
                Flips.first_box_id <= box_id,
                Flips.last_box_id >= box_id,
            )
            .order_by(Run.id)
        )
        return [
            row[0]
            for row in self._session.execute(rows)
            if find_flip(row[1], box_id) is not None
        ]

    def record_flips(
        self, run_id: int, box_ids: IntArray, before: IntArray, after: IntArray
    ) -> None:
        """Store for ever what a run changed; ids are in order."""
        portions = [
            slice(start, start + BOXES_PER_ROW)
            for start in range(0, len(box_ids), BOXES_PER_ROW)
        ]
        rows = [
            {
                "run_id": run_id,
                "first_box_id": int(box_ids[part][0]),
                "last_box_id": int(box_ids[part][-1]),
                "boxes": pack_flips(box_ids[part], before[part], after[part]),
            }
            for part in portions
        ]
        if rows:
            self._session.execute(insert(Flips), rows)


class ExportRepository:
    """Rows of `exports`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def add(self, export: Export) -> Export:
        """Insert."""
        self._session.add(export)
        self._session.flush()
        return export

    def find(self, export_id: int) -> Export | None:
        """An export, unless it was deleted with its dataset."""
        return find_job(self._session, Export, export_id)

    def with_id(self, export_id: int) -> Export:
        """An export; NotFound."""
        found = self.find(export_id)
        if found is None:
            raise NotFound("export", export_id)
        return found

    def page(self, dataset_id: int, page: NewestPage) -> list[Export]:
        """Exports, newest first."""
        return newest(self._session, Export, dataset_id, page)
