"""The answer to work that goes on after it was asked for."""

from __future__ import annotations

from fastapi import Response
from fastapi.responses import JSONResponse
from sqlalchemy.orm import Session

from app.db.tables import Run
from app.services.context import ServiceContext
from app.services.run_states import described_run


def accepted_run(context: ServiceContext, session: Session, run: Run) -> Response:
    """202 with the run, and where to ask for it."""
    return JSONResponse(
        described_run(context, session, run),
        status_code=202,
        headers={"Location": f"/api/v1/runs/{run.id}"},
    )
