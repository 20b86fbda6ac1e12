"""The answer to work that goes on after it was asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastapi import Response
from fastapi.responses import JSONResponse
from sqlalchemy.orm import Session

from app.db.tables import Run
from app.services.context import ServiceContext
from app.services.run_states import described_run


def accepted_run(context: ServiceContext, session: Session, run: Run) -> Response:
    """202 with the run, and where to ask for it."""
    return accepted(described_run(context, session, run))


def accepted(run: Mapping[str, Any]) -> Response:
    """202 with a run that is described already."""
    headers = {"Location": f"/api/v1/runs/{run['id']}"}
    return JSONResponse(run, status_code=202, headers=headers)
