"""Taking the rows of a deleted dataset away, few enough at a time for all to go on.

The order is that of the references: what others refer to goes last.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from app.db.tables import Dataset, DatasetClass, Flips, Frame, Problem, Run

FRAMES_AT_A_TIME: Final = 200
ROWS_AT_A_TIME: Final = 1_000
FLIPS_AT_A_TIME: Final = 50
"""Each row holds thousands of boxes."""


class RemovalRepository:
    """Rows of datasets that nobody sees any more."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def waiting(self) -> list[int]:
        """Ids of datasets that were deleted and have rows."""
        rows = select(Dataset.id).where(Dataset.removed_at.is_not(None))
        return list(self._session.scalars(rows.order_by(Dataset.id)))

    def remove_some(self, dataset_id: int, most_boxes: int) -> bool:
        """Take a portion away; False once nothing is left, the dataset included."""
        steps: tuple[Callable[[int], bool], ...] = (
            partial(self._frames, most_boxes),
            self._flips,
            self._problems,
            self._class,
            self._dataset,
        )
        return any(step(dataset_id) for step in steps)

    def _frames(self, most_boxes: int, dataset_id: int) -> bool:
        rows = (
            select(Frame.id, Frame.box_count)
            .where(Frame.dataset_id == dataset_id)
            .order_by(Frame.id)
            .limit(FRAMES_AT_A_TIME)
        )
        ids: list[int] = []
        boxes = 0
        for frame_id, count in self._session.execute(rows):
            if ids and boxes + count > most_boxes:
                break
            ids.append(frame_id)
            boxes += count
        # Boxes, evidence, decisions and answers go along.
        self._session.execute(delete(Frame).where(Frame.id.in_(ids)))
        return bool(ids)

    def _flips(self, dataset_id: int) -> bool:
        rows = (
            select(Flips.run_id, Flips.first_box_id)
            .join(Run, Run.id == Flips.run_id)
            .where(Run.dataset_id == dataset_id)
            .limit(FLIPS_AT_A_TIME)
        )
        found = self._session.execute(rows).all()
        for run_id, first_box_id in found:
            key = Flips.run_id == run_id, Flips.first_box_id == first_box_id
            self._session.execute(delete(Flips).where(*key))
        return bool(found)

    def _problems(self, dataset_id: int) -> bool:
        rows = select(Problem.id).where(Problem.dataset_id == dataset_id)
        ids = list(self._session.scalars(rows.limit(ROWS_AT_A_TIME)))
        self._session.execute(delete(Problem).where(Problem.id.in_(ids)))
        return bool(ids)

    def _class(self, dataset_id: int) -> bool:
        # One at a time: for each the database looks whether any box refers to it.
        rows = select(DatasetClass.id).where(DatasetClass.dataset_id == dataset_id)
        class_id = self._session.scalar(rows.limit(1))
        self._session.execute(delete(DatasetClass).where(DatasetClass.id == class_id))
        return class_id is not None

    def _dataset(self, dataset_id: int) -> bool:
        # Runs, configurations, measurements and exports go along: some rows each.
        self._session.execute(delete(Dataset).where(Dataset.id == dataset_id))
        return False
