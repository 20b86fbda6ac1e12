"""A run as it is answered."""

from __future__ import annotations

from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.tables import Run
from app.jobs.queries import job_of
from app.measuring.queries import ConfigRepository, DatasetRepository
from unghost.wire import runs as wire


def describe_run(
    context: ServiceContext, run: Run, dataset: str, digest: str
) -> wire.Run:
    """A run as it is answered."""
    reported = context.engine.reported(job_of(run)) if run.state == "running" else 0
    return wire.Run.model_validate(
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


def described_run(context: ServiceContext, session: Session, run: Run) -> wire.Run:
    """A run with the names of what it refers to."""
    dataset = DatasetRepository(session).with_id(run.dataset_id)
    digest = ConfigRepository(session).with_id(run.config_id).digest
    return describe_run(context, run, dataset.name, digest)
