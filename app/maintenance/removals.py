"""Removes the rows of deleted datasets in the background, in small transactions.

The datasets themselves are hidden at once. A row is removed after all rows that refer
to it. Others can write between two transactions. If a process ends before all rows are
removed, another process of the service continues, or the next one that starts.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Final

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.engine import Database
from app.db.tables import Dataset, DatasetClass, Flips, Frame, Problem, Run
from app.maintenance.background import Task, repeating
from app.storage.room import DeletionSignal, Reserve

FRAMES_AT_A_TIME: Final = 200
ROWS_AT_A_TIME: Final = 1_000
FLIPS_AT_A_TIME: Final = 50
"""Few, since each row has thousands of boxes."""


class RemovalRepository:
    """Rows of deleted datasets."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def waiting(self) -> list[int]:
        """Ids of datasets that were deleted and have rows."""
        rows = select(Dataset.id).where(Dataset.removed_at.is_not(None))
        return list(self._session.scalars(rows.order_by(Dataset.id)))

    def remove_some(self, dataset_id: int, most_boxes: int) -> bool:
        """Delete some rows; False once nothing is left, including the dataset."""
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
        # Boxes, evidence, decisions and answers are deleted by cascade.
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
        # One at a time: for each the database checks whether a box refers to it.
        rows = select(DatasetClass.id).where(DatasetClass.dataset_id == dataset_id)
        class_id = self._session.scalar(rows.limit(1))
        self._session.execute(delete(DatasetClass).where(DatasetClass.id == class_id))
        return class_id is not None

    def _dataset(self, dataset_id: int) -> bool:
        # A few runs, configurations, measurements and exports are deleted by cascade.
        self._session.execute(delete(Dataset).where(Dataset.id == dataset_id))
        return False


BOXES_AT_A_TIME: Final = 2_000
"""Boxes per transaction, which takes some tens of ms; a frame is not divided."""
FEW_BOXES: Final = 200
"""Boxes per transaction if there is hardly any disk space for the log."""
LOOK_FOR_WORK_EVERY_S: Final = 5.0
"""Seconds between two checks without a signal: another process may have died."""

log = logging.getLogger(__name__)


def remove_deleted(
    database: Database, reserve: Reserve, stop: Callable[[], bool]
) -> None:
    """Remove all rows of deleted datasets, until `stop` returns True.

    On a full disk a checkpoint is made before and after each transaction, so that
    SQLite's log does not grow. A reader can prevent that; the log then fills the disk,
    and the transaction fails. The next call begins with a checkpoint.
    """
    if not reserve.path.exists():
        database.checkpoint()
    with database.read() as session:
        waiting = RemovalRepository(session).waiting()
    for dataset_id in waiting:
        is_left = True
        while is_left:
            if stop():
                return
            reserve.give_up()
            is_tight = not reserve.path.exists()
            most = FEW_BOXES if is_tight else BOXES_AT_A_TIME
            with database.write() as session:
                is_left = RemovalRepository(session).remove_some(dataset_id, most)
            if is_tight:
                database.checkpoint()
        log.info("the rows of deleted dataset %d have been removed", dataset_id)


@contextmanager
def removing(context: ServiceContext) -> Iterator[None]:
    """Remove rows of deleted datasets in a thread, until the block ends."""
    over, signal = threading.Event(), context.one(DeletionSignal)
    reserve = Reserve(context.settings.data)

    def stop() -> bool:
        return over.is_set() or context.engine.stopping.is_set()

    def remove() -> None:
        remove_deleted(context.database, reserve, stop)
        reserve.keep(int(context.settings.min_free_bytes))

    signal.set()  # a process that died may have left rows
    purpose = "remove the rows of deleted datasets"
    task = Task("removals", purpose, remove, LOOK_FOR_WORK_EVERY_S, signal)
    with repeating(context, task):
        try:
            yield
        finally:
            over.set()
