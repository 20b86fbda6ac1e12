"""Looking, now and then, for jobs that nobody drives: whoever did may have died."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Final

from sqlalchemy.exc import SQLAlchemyError

from app.engine import Job
from app.process_identity import has_ended
from app.repositories.leases import LeaseRepository
from app.repositories.runs import ExportRepository, RunRepository
from app.services.context import ServiceContext
from app.services.export_jobs import start_exports
from app.services.export_writing import job_of as export_job
from app.services.run_states import job_of as run_job
from app.services.runs import start_runs

LOOK_EVERY_S: Final = 2.0
NOBODYS_AFTER: Final = timedelta(seconds=10)
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


def abandoned(context: ServiceContext) -> set[Job]:
    """Unfinished jobs whose driver has died, or that nobody has begun for long."""
    with context.database.read() as session:
        runs = RunRepository(session).unfinished()
        exports = ExportRepository(session).unfinished()
        asked_at = {run_job(run.id): run.created_at for run in runs}
        asked_at |= {export_job(one.id): one.created_at for one in exports}
        if not asked_at:
            return set()
        leases = LeaseRepository(session)
        driven, void = leases.live(has_ended)
        begun_by = leases.now() - NOBODYS_AFTER
    return {
        job
        for job, at in asked_at.items()
        if job not in driven and (job in void or at < begun_by)
    }


def _watch(context: ServiceContext, over: threading.Event) -> None:
    while not over.wait(LOOK_EVERY_S) and not context.engine.stopping.is_set():
        try:
            kinds = {job.kind for job in abandoned(context)}
        except SQLAlchemyError as exc:  # it may be away for a while
            log.warning("cannot look for unfinished jobs: %s", exc)
            continue
        if "run" in kinds:
            start_runs(context)
        if "export" in kinds:
            start_exports(context)
