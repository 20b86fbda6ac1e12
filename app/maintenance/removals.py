"""Removes the rows of deleted datasets and the files of old exports, in the background.

The datasets themselves are hidden at once. A row is removed after all rows that refer
to it. Others can write between two transactions. If a process ends before all rows are
removed, another process of the service continues, or the next one that starts.
"""

from __future__ import annotations

import logging
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Final

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from app.addresses import FOLDER
from app.background import Task, repeating
from app.context import ServiceContext
from app.db.base import Repository, utc_now
from app.db.engine import Database, keep_turn
from app.db.tables import Dataset, DatasetClass, Export, Flips, Frame, Problem, Run
from app.errors import StorageAway
from app.maintenance.datafolder import CannotMaintain, alone
from app.maintenance.queries import StoredFileRepository
from app.settings import Settings
from app.storage.base import BlobStore
from app.storage.room import DeletionSignal, Reserve

FRAMES_AT_A_TIME: Final = 200
ROWS_AT_A_TIME: Final = 1_000
FLIPS_AT_A_TIME: Final = 50
"""Few, since each row has thousands of boxes."""


class RemovalRepository(Repository):
    """Rows of deleted datasets."""

    def waiting(self) -> list[int]:
        """Ids of datasets that were deleted and have rows."""
        rows = select(Dataset.id).where(Dataset.removed_at.is_not(None))
        return list(self._session.scalars(rows.order_by(Dataset.id)))

    def remove_some(self, dataset_id: int, most_boxes: int) -> bool:
        """Delete some rows; False once nothing is left, including the dataset."""
        steps = (self._flips, self._problems, self._class)
        if self._frames(dataset_id, most_boxes) or any(
            step(dataset_id) for step in steps
        ):
            return True
        # A few runs, configurations, measurements and exports are deleted by cascade.
        self._session.execute(delete(Dataset).where(Dataset.id == dataset_id))
        return False

    def _frames(self, dataset_id: int, most_boxes: int) -> bool:
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
        keys = self._session.execute(rows).all()
        for run_id, first_box_id in keys:
            key = Flips.run_id == run_id, Flips.first_box_id == first_box_id
            self._session.execute(delete(Flips).where(*key))
        return bool(keys)

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


SHARE_OF_EXPORTS: Final = 4
"""The files of all exports take at most the size of the disk divided by this."""
PUT_BEFORE_S: Final = 60.0
"""A file that was put so long after an export had ended is kept: another export with
the same content is about to end. (The clock of a bucket may differ from this one's.)"""


def remove_file_of_export(
    session: Session, settings: Settings, store: BlobStore, export: Export
) -> None:
    """Remove the file of an export that is done, unless other rows refer to it.

    Call it in the transaction that deletes the export or its digest. In a bucket, a
    file that was just put stays until the next garbage collection. Raises
    CannotMaintain if a backup is being made, which may need the file, or a garbage
    collection.
    """
    digest, ended = export.sha256, export.finished_at
    export.sha256 = None
    session.flush()
    if digest is None or ended is None:
        return
    with alone(settings):
        keep_turn(session)
        if not StoredFileRepository(session).referred_to([digest]):
            put_before = min(time.time(), ended.timestamp() + PUT_BEFORE_S)
            store.remove([digest], unused_since=put_before)


def overdue_exports(session: Session, settings: Settings) -> dict[int, str]:
    """The exports whose files are to be deleted, oldest first, and why."""
    largest: int | None = None
    if settings.max_export_bytes is not None:
        largest = int(settings.max_export_bytes)
    elif settings.storage == FOLDER:
        largest = shutil.disk_usage(settings.data).total // SHARE_OF_EXPORTS
    days = settings.export_days
    rows = (
        select(Export.id, Export.finished_at, Export.sha256, Export.size_bytes)
        .where(Export.state == "done", Export.sha256.is_not(None))
        .where(Export.name.is_(None))  # versions are kept
        .order_by(Export.finished_at.desc(), Export.id.desc())
    )
    counted: set[str | None] = set()
    total = 0
    overdue: dict[int, str] = {}
    for export_id, ended, digest, size_bytes in session.execute(rows):
        if digest not in counted:
            counted.add(digest)
            total += size_bytes or 0
        if days and ended and ended < utc_now() - timedelta(days=days):
            overdue[export_id] = f"after {days} days (UNGHOST_EXPORT_DAYS)"
        elif largest is not None and total > largest and len(counted) > 1:
            overdue[export_id] = (
                f"to make place for newer ones: all together may have {largest} bytes "
                "(UNGHOST_MAX_EXPORT_BYTES)"
            )
    return dict(reversed(overdue.items()))


def remove_old_exports(context: ServiceContext, reserve: Reserve) -> None:
    """Delete the files of exports that are too old or too many; their rows say so.

    During a backup or a garbage collection, nothing is deleted.
    """
    settings = context.settings
    with context.database.read() as session:
        overdue = overdue_exports(session, settings)
    for export_id, why in overdue.items():
        reserve.give_up()
        try:
            with context.database.write() as session:
                export = session.get(Export, export_id)
                if export is None or export.sha256 is None:
                    continue
                text = f"its file was deleted {why}; start a new export"
                export.error = {"code": "export_removed", "detail": text}
                remove_file_of_export(session, settings, context.storage, export)
        except (CannotMaintain, StorageAway):
            return
        log.info("the file of export %d was deleted %s", export_id, why)


@contextmanager
def removing(context: ServiceContext) -> Iterator[None]:
    """Remove rows of deleted datasets in a thread, until the block ends."""
    over, signal = threading.Event(), context.one(DeletionSignal)
    reserve = Reserve(context.settings.data)

    def stop() -> bool:
        return over.is_set() or context.engine.stopping.is_set()

    def remove() -> None:
        remove_deleted(context.database, reserve, stop)
        remove_old_exports(context, reserve)
        reserve.keep(int(context.settings.min_free_bytes))

    signal.set()  # a process that died may have left rows
    purpose = "remove the rows of deleted datasets"
    task = Task("removals", purpose, remove, LOOK_FOR_WORK_EVERY_S, signal)
    with repeating(context, task):
        try:
            yield
        finally:
            over.set()
