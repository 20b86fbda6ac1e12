"""The states of a run: queued, running, and then done, failed or cancelled for ever."""

from __future__ import annotations

from typing import Final

from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db import tables
from app.engine import Job, JobStopped
from app.measuring.queries import ConfigRepository, DatasetRepository
from app.repositories.runs import RunRepository
from unghost.wire.runs import Run

OPEN: Final = ("queued", "running")


def job_of(run_id: int) -> Job:
    """The job that carries out a run."""
    return Job("run", run_id)


def run_at_work(session: Session, run_id: int) -> tables.Run:
    """The run, if it is to go on.

    Raises
    ------
    JobStopped
        It was cancelled, or its dataset was deleted.
    """
    run = RunRepository(session).find(run_id)
    if run is None or run.state not in OPEN:
        raise JobStopped(job_of(run_id))
    return run


def describe_run(
    context: ServiceContext, run: tables.Run, dataset: str, digest: str
) -> Run:
    """A run as it is answered."""
    reported = context.engine.reported(job_of(run.id)) if run.state == "running" else 0
    return Run.model_validate(
        {
            "id": run.id,
            "dataset": dataset,
            "kind": run.kind,
            "state": run.state,
            "config": digest,
            "activate": run.activate,
            "total": run.total,
            "done": max(run.done, reported),
            "changed": run.changed,
            "counts": run.counts or {},
            "error": run.error,
            "created_by": run.created_by,
            "created_at": run.created_at,
            "started_at": run.started_at,
            "finished_at": run.finished_at,
        }
    )


def described_run(context: ServiceContext, session: Session, run: tables.Run) -> Run:
    """A run with the names of what it refers to."""
    dataset = DatasetRepository(session).with_id(run.dataset_id)
    digest = ConfigRepository(session).with_id(run.config_id).digest
    return describe_run(context, run, dataset.name, digest)
