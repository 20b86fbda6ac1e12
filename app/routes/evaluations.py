"""Channels compared with instances or with people."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Response

from app.http.deps import AppServices, CurrentPrincipal, ReadSession, WriteSession
from app.http.routing import ApiRouter
from app.repositories.datasets import DatasetRepository
from app.routes.accepted import accepted
from app.routes.datasets import DatasetName
from app.services.evaluations import evaluation, request_evaluation
from app.services.run_states import described_run
from app.services.runs import start_after
from unghost.wire.quality import Evaluation, EvaluationQuery
from unghost.wire.runs import Run

router = ApiRouter(prefix="/api/v1", tag="evaluations")


@router.post("/datasets/{dataset}/evaluations", status_code=202, response_model=Run)
def create_evaluation(
    dataset: DatasetName,
    session: WriteSession,
    services: AppServices,
    principal: CurrentPrincipal,
) -> Response:
    """Measure every channel that the frames' files allow; verdicts stay as they are."""
    found = DatasetRepository(session).named(dataset)
    run = request_evaluation(services, session, found, principal.name)
    start_after(services, session)
    return accepted(described_run(services, session, run))


@router.get("/datasets/{dataset}/evaluations")
def get_evaluation(
    dataset: DatasetName,
    session: ReadSession,
    services: AppServices,
    query: Annotated[EvaluationQuery, Query()],
) -> Evaluation:
    """Precision, recall and F1 of every measured channel, from the numbers at hand."""
    found = DatasetRepository(session).named(dataset)
    return evaluation(services, session, found, query.truth)
