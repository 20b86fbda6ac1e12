"""The answer to work that goes on after it was asked for."""

from __future__ import annotations

from fastapi import Response
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db import tables
from app.http.pages import written
from app.services.run_states import described_run
from unghost.wire.runs import Run


def accepted_run(
    context: ServiceContext, session: Session, run: tables.Run
) -> Response:
    """202 with the run, and where to ask for it."""
    return accepted(described_run(context, session, run))


def accepted(run: Run) -> Response:
    """202 with a run that is described already."""
    return written(run, 202, {"Location": f"/api/v1/runs/{run.id}"})
