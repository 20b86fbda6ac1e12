"""SQL of runs and of what they changed."""

from __future__ import annotations

from typing import Final

import numpy as np
from sqlalchemy import insert, select

from app.catalog.datasets import is_there
from app.db.base import Repository, insert_row
from app.db.pages import NewestPage
from app.db.tables import Dataset, Flips, Run
from app.jobs.queries import OPEN
from filter_core.arrays import IntArray

FLIP: Final = np.dtype([("box_id", "<i8"), ("before", "u1"), ("after", "u1")])
BOXES_PER_ROW: Final = 8192
"""80 KiB: fast to read for the history of one box, and few rows for a million."""
_ACTIVATES: Final = (Run.state.in_(OPEN), Run.activate.is_(True))


def pack_flips(box_ids: IntArray, before: IntArray, after: IntArray) -> bytes:
    """Pack boxes, given in order of id, with their reasons before and after."""
    record = np.zeros(len(box_ids), FLIP)
    record["box_id"], record["before"], record["after"] = box_ids, before, after
    return record.tobytes()


def find_flip(packed: bytes, box_id: int) -> tuple[int, int] | None:
    """Reasons before and after of one box; None if it did not change."""
    record = np.frombuffer(packed, FLIP)
    at = int(np.searchsorted(record["box_id"], box_id))
    if at == len(record) or record["box_id"][at] != box_id:
        return None
    return int(record["before"][at]), int(record["after"][at])


class RunRepository(Repository):
    """Rows of `runs`."""

    def add(self, run: Run) -> Run:
        """Insert a run, which has its id afterwards."""
        return insert_row(self._session, run)

    def page(
        self, page: NewestPage, state: str | None, dataset_id: int | None = None
    ) -> list[Run]:
        """The runs of a page, newest first, and one more if there is a next page."""
        rows = select(Run).join(Dataset, Dataset.id == Run.dataset_id).where(is_there())
        if dataset_id is not None:
            rows = rows.where(Run.dataset_id == dataset_id)
        if state is not None:
            rows = rows.where(Run.state == state)
        return list(self._session.scalars(page.of(rows, Run.id)))

    def last_to_activate(self, dataset_id: int) -> Run | None:
        """The last open run that will activate its configuration, if there is one."""
        rows = select(Run).where(Run.dataset_id == dataset_id, *_ACTIVATES)
        return self._session.scalar(rows.order_by(Run.id.desc()).limit(1))

    def has_to_wait(self, run: Run) -> bool:
        """Whether an earlier run of the dataset has to be activated before this one.

        Each run was requested as a change of the settings that earlier ones activate.
        """
        if not run.activate:
            return False
        rows = select(Run.id).where(Run.dataset_id == run.dataset_id, *_ACTIVATES)
        return self._session.scalar(rows.where(Run.id < run.id).limit(1)) is not None

    def with_flips_of(self, dataset_id: int, box_id: int) -> list[Run]:
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
        runs = self._session.execute(rows)
        return [run for run, packed in runs if find_flip(packed, box_id) is not None]

    def record_flips(
        self, run_id: int, box_ids: IntArray, before: IntArray, after: IntArray
    ) -> None:
        """Store the changes of a run; ids are in order."""
        rows = []
        for start in range(0, len(box_ids), BOXES_PER_ROW):
            part = slice(start, start + BOXES_PER_ROW)
            ids = box_ids[part]
            rows.append(
                {
                    "run_id": run_id,
                    "first_box_id": int(ids[0]),
                    "last_box_id": int(ids[-1]),
                    "boxes": pack_flips(ids, before[part], after[part]),
                }
            )
        if rows:
            self._session.execute(insert(Flips), rows)
