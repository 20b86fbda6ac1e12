"""Looking, now and then, for jobs that nobody drives: whoever did may have died."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from sqlalchemy.exc import SQLAlchemyError

from app.context import ServiceContext
from app.engine import Job
from app.jobs.leases import has_ended
from app.jobs.queries import LeaseRepository
from app.repositories.runs import ExportRepository, RunRepository
from app.services.export_jobs import start_exports
from app.services.export_writing import job_of as export_job
from app.services.run_states import job_of as run_job
from app.services.runs import start_runs

LOOK_EVERY_S: Final = 2.0
NOBODYS_AFTER_S: Final = 10.0
"""For so long whoever was asked for a job has time to begin with it."""

log = logging.getLogger(__name__)


@contextmanager
def watching_jobs(context: ServiceContext) -> Iterator[None]:
    """Start what is unfinished, now and again and again until the block ends."""
    start_runs(context)
    start_exports(context)
    over = threading.Event()
    watch = threading.Thread(target=_watch, args=(context, over), name="job watch")
    watch.start()
    try:
        yield
    finally:
        over.set()
        watch.join()


class JobWatch:
    """Knows since when it has seen each unfinished job without a driver.

    By its own clock: that of the service that was asked for a job may be wrong.
    """

    def __init__(
        self, context: ServiceContext, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._context, self._clock = context, clock
        self._alone_since: dict[Job, float] = {}

    def abandoned(self) -> set[Job]:
        """Unfinished jobs whose driver has died, or that nobody has begun for long.

        Leases that somebody left behind with a job that is over are cleared away.
        """
        with self._context.database.read() as session:
            runs = RunRepository(session).unfinished()
            exports = ExportRepository(session).unfinished()
            driven, void = LeaseRepository(session).live(has_ended)
        unfinished = {run_job(one.id) for one in runs}
        unfinished |= {export_job(one.id) for one in exports}
        if void - unfinished:
            self._clear(void - unfinished)
        now, before = self._clock(), self._alone_since
        alone = unfinished - driven
        self._alone_since = {job: before.get(job, now) for job in alone}
        late = {
            job
            for job, since in self._alone_since.items()
            if now - since >= NOBODYS_AFTER_S
        }
        return alone & (void | late)

    def _clear(self, jobs: set[Job]) -> None:
        with self._context.database.write_beside() as session:
            for job in jobs:
                LeaseRepository(session).clear(job, has_ended)


def _watch(context: ServiceContext, over: threading.Event) -> None:
    watch = JobWatch(context)
    while not over.wait(LOOK_EVERY_S) and not context.engine.stopping.is_set():
        try:
            kinds = {job.kind for job in watch.abandoned()}
        except SQLAlchemyError as exc:  # it may be away for a while
            log.warning("cannot look for unfinished jobs: %s", exc)
            continue
        if "run" in kinds:
            start_runs(context)
        if "export" in kinds:
            start_exports(context)
