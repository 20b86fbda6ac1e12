"""Runs: one configuration applied to a whole dataset."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query, Request, Response

from app.access.audit import Act
from app.access.gate import Audited
from app.db import tables
from app.http.deps import (
    MAX_ID,
    AppServices,
    DatasetName,
    ReadSession,
    RowId,
    WriteSession,
)
from app.http.pages import Cursor, Limit, Newest, accepted, linked
from app.http.routing import ApiRouter
from app.jobs.service import cancel
from app.jobs.stream import LastEventId, events_of, watch
from app.measuring.queries import ConfigRepository, DatasetRepository
from app.repositories.runs import RunRepository
from app.runs.flips import DiffPage, compared_runs, run_diff
from app.services.run_requests import RunRequest, request_run
from app.services.run_states import describe_run, described_run
from app.services.runs import RUNS
from filter_core.config.filter import FilterConfig
from unghost.wire.model import Page
from unghost.wire.runs import Diff, Run, RunIn

router = ApiRouter(prefix="/api/v1", tag="runs")


@router.get("/datasets/{dataset}/runs", response_model=Page[Run])
def list_runs(
    dataset: DatasetName, wanted: Newest, session: ReadSession, services: AppServices
) -> Response:
    """Runs of a dataset, newest first."""
    found = DatasetRepository(session).named(dataset)
    rows = RunRepository(session).page(found.id, wanted.page)
    digests = ConfigRepository(session).digests(row.config_id for row in rows)

    def describe(run: tables.Run) -> Run:
        return describe_run(services, run, dataset, digests[run.config_id])

    return wanted.answer(rows, describe)


@router.post("/datasets/{dataset}/runs", status_code=202, response_model=Run)
def create_run(
    dataset: DatasetName,
    body: RunIn,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Decide again from numbers, or measure again, as the configuration needs."""
    found = DatasetRepository(session).named(dataset)
    config = body.config
    wanted = RunRequest(
        config if isinstance(config, str) else FilterConfig.from_mapping(config.root),
        audit.name,
        activate=body.activate,
    )
    run = request_run(services, session, found, wanted)
    answer = described_run(services, session, run)
    if run.activate:
        activated = {"config": answer.config, "run": run.id}
        audit.note(Act.CONFIG_ACTIVATED, dataset, **activated)
    return accepted(answer)


@router.get("/runs/{run_id}")
def get_run(run_id: RowId, session: ReadSession, services: AppServices) -> Run:
    """A run and how far it is."""
    return described_run(services, session, RunRepository(session).with_id(run_id))


@router.get(
    "/runs/{run_id}/events", response_class=Response, responses=events_of(Run, "run")
)
async def watch_run(
    run_id: RowId,
    request: Request,
    services: AppServices,
    last_event_id: LastEventId = None,
) -> Response:
    """How a run goes on, as server-sent events; the last one is `end`."""
    return await watch(request, services, RUNS, run_id, last_event_id)


@router.post("/runs/{run_id}/cancel", status_code=202, response_model=Run)
def stop_run(
    run_id: RowId, session: WriteSession, services: AppServices, audit: Audited
) -> Response:
    """End a run that is not over; nothing changes in its dataset. 409 if it is over."""
    run = cancel(services, session, RUNS, run_id)
    answer = described_run(services, session, run)
    audit.note(Act.RUN_CANCELLED, run_id, dataset=answer.dataset)
    return accepted(answer)


async def diff_page(limit: Limit = 100, cursor: Cursor = None) -> DiffPage:
    """Which of the flips are asked for."""
    return DiffPage(limit, cursor)


def compared(
    run_id: RowId,
    session: ReadSession,
    against: Annotated[
        int | None,
        Query(ge=1, le=MAX_ID, description="Another run; else the active one before."),
    ] = None,
) -> tuple[tables.Run, tables.Run]:
    """The run to compare with, and the run of the path."""
    return compared_runs(session, run_id, against)


@router.get(
    "/runs/{run_id}/diff",
    response_model=Diff,
    responses={409: {"description": "One of the runs is not done."}},
)
def compare_runs(
    runs: Annotated[tuple[tables.Run, tables.Run], Depends(compared)],
    request: Request,
    session: ReadSession,
    services: AppServices,
    page: Annotated[DiffPage, Depends(diff_page)],
) -> Response:
    """Boxes that a run decides otherwise than another, nearest to a threshold first."""
    found = run_diff(services, session, runs, page)
    return linked(request, found, found.next_cursor)
