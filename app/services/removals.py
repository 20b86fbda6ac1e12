"""Deleted datasets disappear at once; their rows go in the background, bit by bit.

Between two portions anybody may write. What a process leaves behind when it ends, the
next one to serve the folder, or another one that serves it, goes on with.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from sqlalchemy.exc import SQLAlchemyError

from app.db.engine import Database
from app.repositories.removals import RemovalRepository
from app.services.context import ServiceContext
from app.services.room import Reserve

BOXES_AT_A_TIME: Final = 2_000
"""Some tens of milliseconds; a frame is not divided."""
FEW_BOXES: Final = 200
"""Where there is hardly any room to write down what is changed."""
LOOK_EVERY_S: Final = 5.0
"""Where nobody says that there is something to do: another process may have died."""

log = logging.getLogger(__name__)


def remove_deleted(
    database: Database, reserve: Reserve, stop: Callable[[], bool]
) -> None:
    """Take away all rows of datasets that were deleted, until told to stop."""
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
                database.fold_log()
        log.info("the rows of deleted dataset %d are gone", dataset_id)


@contextmanager
def removing(context: ServiceContext) -> Iterator[None]:
    """Do so whenever one is deleted, and go on with what is left, until the end."""
    over = threading.Event()
    watch = threading.Thread(target=_watch, args=(context, over), name="removals")
    watch.start()
    try:
        yield
    finally:
        over.set()
        context.something_to_remove.set()
        watch.join()


def _watch(context: ServiceContext, over: threading.Event) -> None:
    def stop() -> bool:
        return over.is_set() or context.engine.stopping.is_set()

    while not stop():
        context.something_to_remove.clear()
        try:
            remove_deleted(context.database, context.reserve, stop)
            context.reserve.keep(int(context.settings.min_free_bytes))
        except (
            SQLAlchemyError,
            OSError,
        ) as exc:  # it may be away, or its disk full, for a while
            text = str(exc).partition("\n")[0]
            log.warning("deleted datasets are not removed yet: %s", text)
        if not over.is_set():
            context.something_to_remove.wait(LOOK_EVERY_S)
