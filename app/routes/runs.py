"""Runs: one configuration applied to a whole dataset."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query, Request, Response

from app.deps import AppServices, CurrentPrincipal, ReadSession, RowId, WriteSession
from app.repositories.datasets import DatasetRepository
from app.repositories.runs import ConfigRepository, RunRepository
from app.routes.accepted import accepted_run, described_run
from app.routes.datasets import DatasetName
from app.routing import ApiRouter
from app.schemas.pages import Limit, Page, page_response
from app.schemas.runs import RunIn, RunOut
from app.services.run_requests import RunRequest, describe_run, request_run
from app.services.runs import start_after
from filter_core.config import FilterConfig

router = ApiRouter(prefix="/api/v1", tag="runs")


@router.get("/datasets/{dataset}/runs", response_model=Page[RunOut])
def list_runs(
    request: Request,
    dataset: DatasetName,
    session: ReadSession,
    limit: Limit = 100,
    cursor: Annotated[int | None, Query(ge=1, le=2**63 - 1)] = None,
) -> Response:
    """Runs of a dataset, newest first."""
    found = DatasetRepository(session).named(dataset)
    rows = RunRepository(session).page(found.id, before_id=cursor, limit=limit + 1)
    digests = ConfigRepository(session).digests(row.config_id for row in rows)
    items = [describe_run(row, dataset, digests[row.config_id]) for row in rows[:limit]]
    more = len(rows) > limit
    return page_response(request, items, str(rows[limit - 1].id) if more else None)


@router.post("/datasets/{dataset}/runs", status_code=202, response_model=RunOut)
def create_run(
    dataset: DatasetName,
    body: RunIn,
    session: WriteSession,
    services: AppServices,
    principal: CurrentPrincipal,
) -> Response:
    """Decide again from numbers, or measure again, as the configuration needs."""
    found = DatasetRepository(session).named(dataset)
    config = body.config
    wanted = RunRequest(
        config if isinstance(config, str) else FilterConfig.from_mapping(config),
        principal.name,
        activate=body.activate,
    )
    run = request_run(services, session, found, wanted)
    start_after(services, session)
    return accepted_run(session, run)


@router.get("/runs/{run_id}", response_model=RunOut)
def get_run(run_id: RowId, session: ReadSession) -> dict[str, Any]:
    """A run and how far it is."""
    return described_run(session, RunRepository(session).with_id(run_id))
