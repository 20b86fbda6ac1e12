"""The answer to work that goes on after it was asked for."""

from __future__ import annotations

from typing import Any

from fastapi import Response
from fastapi.responses import JSONResponse
from sqlalchemy.orm import Session

from app.db.tables import Run
from app.repositories.datasets import DatasetRepository
from app.repositories.runs import ConfigRepository
from app.services.run_requests import describe_run


def accepted_run(session: Session, run: Run) -> Response:
    """202 with the run, and where to ask for it."""
    return JSONResponse(
        described_run(session, run),
        status_code=202,
        headers={"Location": f"/api/v1/runs/{run.id}"},
    )


def described_run(session: Session, run: Run) -> dict[str, Any]:
    """A run as it is answered."""
    dataset = DatasetRepository(session).with_id(run.dataset_id)
    digest = ConfigRepository(session).with_id(run.config_id).digest
    return describe_run(run, dataset.name, digest)
