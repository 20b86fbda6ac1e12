"""Caches of numbers that interrupt a run while they are loaded."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from app.jobs.service import cancel
from app.measuring.columns import ColumnCache, DatasetColumns
from app.runs.service import RUNS
from tests.support.services import run_job


class InterruptedNumbers(ColumnCache):
    """Numbers during whose first loading somebody uploads a frame."""

    def __init__(self, interruption: Callable[[], object], *, before: bool) -> None:
        super().__init__()
        self._waiting = [interruption]
        self._before = before

    def load(self, session, dataset_id, measurement_id) -> DatasetColumns:
        if self._before:
            self._interrupt()
        loaded = super().load(session, dataset_id, measurement_id)
        self._interrupt()
        return loaded

    def _interrupt(self) -> None:
        while self._waiting:
            self._waiting.pop()()


class CancelledNumbers(ColumnCache):
    """Numbers that are loaded for the third time while somebody cancels the run.

    Twice they are loaded before the last transaction, and then within it.
    """

    def __init__(self, services, run_id: int) -> None:
        super().__init__()
        self._services, self._run_id = services, run_id
        self._loads = 0
        self.answers: list[Future[str]] = []

    def load(self, session, dataset_id, measurement_id) -> DatasetColumns:
        self._loads += 1
        if self._loads == 3:
            pool = ThreadPoolExecutor(1)
            self.answers.append(pool.submit(self._cancel))
            job = run_job(self._run_id)
            while job not in self._services.context.engine.interrupted():
                time.sleep(0.001)
        return super().load(session, dataset_id, measurement_id)

    def _cancel(self) -> str:
        with self._services.context.database.write() as session:
            return cancel(self._services.context, session, RUNS, self._run_id).state
