"""The answer to work that goes on after it was asked for."""

from __future__ import annotations

from fastapi import Response

from app.http.pages import written
from unghost.wire.runs import Run


def accepted(run: Run) -> Response:
    """202 with a run, and where to ask for it."""
    return written(run, 202, {"Location": f"/api/v1/runs/{run.id}"})
