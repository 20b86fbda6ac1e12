"""How many files are stored, and how large they are: the one sum that takes time."""

from __future__ import annotations

import time
from typing import Final

from sqlalchemy.exc import SQLAlchemyError

from app.db.engine import Database
from app.engine import LocalEngine
from app.logs import error_log
from app.ops.queries import BlobTotals, Totals

LEAST_PAUSE_S: Final = 60
MOST_OF_A_THREAD: Final = 0.01
"""The share of one thread that counting blobs may take."""


class BlobCount:
    """The blobs as they were counted last; counted in the background, now and then."""

    def __init__(self) -> None:
        self._newest: BlobTotals | None = None
        self._next_at = float("-inf")

    def newest(self, database: Database, engine: LocalEngine) -> BlobTotals | None:
        """What is known; None until the first count is over."""
        if time.monotonic() >= self._next_at and not engine.stopping.is_set():
            self._next_at = float("inf")
            engine.start(self._count, database)
        return self._newest

    def _count(self, database: Database) -> None:
        begun = time.monotonic()
        try:
            with database.read() as session:
                self._newest = Totals(session).blobs()
        except SQLAlchemyError as exc:
            error_log.warning("the blobs cannot be counted", exc_info=exc)
        now = time.monotonic()
        pause = max(LEAST_PAUSE_S, (now - begun) / MOST_OF_A_THREAD)
        self._next_at = now + pause
