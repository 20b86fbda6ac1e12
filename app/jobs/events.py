"""The progress of a job as events for the clients that watch it.

Events are derived from the job's row, so that any process can send them, no matter
which one drives the job.
"""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Final, NamedTuple

from anyio import CapacityLimiter, Lock, sleep, to_thread

from app.context import ServiceContext
from app.engine.chunk import Job
from app.errors import NotFound, TooManyRequests
from app.jobs.kind import Described, kind_of
from app.jobs.queries import find_job
from app.settings import Settings

NOTHING_SEEN: Final = -1
INTERVAL_S: Final = 0.2
"""Interval between two reads of a job's row: more events per second are no use."""


class JobEvent(NamedTuple):
    """The state of a job; `number` increases, and is the same for every client."""

    name: str
    number: int
    state: Described


async def job_events(
    context: ServiceContext, job: Job, after: int
) -> AsyncGenerator[JobEvent | None, None]:
    """Each change of a job after the event with the number `after`, and its end.

    Iterate inside `Poller.watching`. Yields None at each interval without a change, so
    that the caller can send a heartbeat. If the job is deleted, the events stop without
    an `end`.
    """
    read, poller = partial(_read, context), context.one(Poller)
    while not context.engine.stopping.is_set():
        state = await poller.newest(job, read)
        if state is None:
            return
        number = progress_number(state)
        yield JobEvent("progress", number, state) if number > after else None
        if state.finished:
            yield JobEvent("end", end_number(state), state)
            return
        after = max(after, number)
        await sleep(INTERVAL_S)


async def newest(context: ServiceContext, job: Job) -> Described:
    """The current state of a job, inside `Poller.watching`; raises NotFound."""
    state = await context.one(Poller).newest(job, partial(_read, context))
    if state is None:
        raise NotFound(*job)
    return state


def progress_number(state: Described) -> int:
    """0 if queued, 1 + the frames done if running, and 2 + all frames if finished."""
    if state.state == "queued":
        return 0
    return end_number(state) - 1 if state.finished else 1 + state.done


def end_number(state: Described) -> int:
    """The number of a job's last event."""
    return state.total + 3


def _read(context: ServiceContext, job: Job) -> Described | None:
    kind = kind_of(job)
    with context.database.read() as session:
        row = find_job(session, kind.table, job.id)
        return None if row is None else kind.describe(context, session, row)


@dataclass
class _Watched:
    """A job with watchers; `seen` is None if the job was deleted."""

    watchers: int = 0
    at: float = float("-inf")
    seen: Described | None = None
    lock: Lock = field(default_factory=Lock)


class Poller:
    """A cache of the states of watched jobs; used on one event loop only.

    Watchers hold no thread and no connection between two reads. Reads have a thread of
    their own: all threads of requests may be waiting for a transaction.
    """

    def __init__(self) -> None:
        self._watched: dict[Job, _Watched] = {}
        self._thread = CapacityLimiter(1)

    @property
    def watchers(self) -> int:
        """How many clients watch a job."""
        return sum(each.watchers for each in list(self._watched.values()))

    @contextmanager
    def watching(self, job: Job, settings: Settings) -> Iterator[None]:
        """Register a watcher of this job during the block.

        Raises TooManyRequests if as many are registered as the settings allow.
        """
        most = settings.max_event_streams
        if self.watchers >= most:
            raise TooManyRequests(f"{most} streams are open already; try later")
        watched = self._watched.setdefault(job, _Watched())
        watched.watchers += 1
        try:
            yield
        finally:
            watched.watchers -= 1
            if not watched.watchers:
                del self._watched[job]

    async def newest(
        self, job: Job, read: Callable[[Job], Described | None]
    ) -> Described | None:
        """The result of `read`, called now or within the last interval.

        The job has to be watched: see `watching`.
        """
        watched = self._watched[job]
        async with watched.lock:
            if time.monotonic() - watched.at >= INTERVAL_S:
                watched.seen = await to_thread.run_sync(read, job, limiter=self._thread)
                watched.at = time.monotonic()
        return watched.seen
