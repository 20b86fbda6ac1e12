"""The results of a run are right if its chunks are reordered, repeated or lost."""

import random
import threading
from concurrent.futures import Future
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from app.engine.chunk import WorkerDied
from app.jobs.attempts import MOST_ATTEMPTS
from app.jobs.driver import drive_job
from tests.support import chunks as runs
from tests.support.services import run_job

OUTCOMES = ("once", "twice", "dies before", "dies after", "lost before", "lost after")


class FaultyEngine(runs.SmallChunks):
    """An engine with a random order of chunks, and a given fate for each of them."""

    def __init__(self, fates: list[str], seed: int) -> None:
        super().__init__()
        self._fates, self._dice = list(fates), random.Random(seed)
        self._deaths = 0
        self._waiting: list[tuple[Any, ...]] = []
        self._pulling = threading.Lock()

    def start_chunk(self, here, job, number):
        future: Future[str] = Future()
        with self._pulling:
            self._waiting.append((future, here, job, number))
        self.run_later(self._run_a_random_chunk)
        return future

    def _run_a_random_chunk(self):
        with self._pulling:
            place = self._dice.randrange(len(self._waiting))
            future, here, job, number = self._waiting.pop(place)
            fate = self._fates.pop() if self._fates else "once"
            if fate.startswith("dies"):
                # Fewer deaths than a chunk needs to be put into quarantine.
                fate = fate if self._deaths < MOST_ATTEMPTS - 1 else "once"
                self._deaths += fate.startswith("dies")
        self._complete_by_fate(fate, future, lambda: here(job.kind, job.id, number))

    def _complete_by_fate(self, fate, future, work):
        if fate == "twice":
            work()
        told = None if fate.endswith("before") else work()
        if fate.startswith("lost"):
            future.cancel()
            future.set_running_or_notify_cancel()
        elif fate.startswith("dies"):
            future.set_exception(WorkerDied("as drawn"))
        else:
            future.set_result(told)

    outcome = runs.DisconnectingEngine.outcome


@given(
    fates=st.lists(st.sampled_from(OUTCOMES), max_size=8), seed=st.integers(0, 10**6)
)
def test_each_frame_counts_once_if_chunks_are_reordered_repeated_or_lost(
    services, fates, seed
):
    street = services.dataset()
    for number in range(runs.FRAMES):
        runs.put(street, number)
    run_id = street.request(runs.FROM_PIXELS)

    with runs.context_with_engine(street, FaultyEngine(fates, seed)) as context:
        drive_job(context, run_job(run_id))

    runs.check_run_is_complete(street, runs.run_of(street, run_id))
