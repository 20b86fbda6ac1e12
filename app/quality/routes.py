"""Routes that compare the filter with people, and kinds of evidence with the truth."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Response

from app.access.audit import AuditAction
from app.access.gate import Audited
from app.catalog.datasets import DatasetRepository
from app.db.base import existing
from app.http.deps import (
    AppServices,
    DatasetName,
    ReadSession,
    Reviewer,
    Viewer,
    require_room_to_write,
)
from app.http.pages import accepted
from app.http.routing import ApiRouter
from app.http.transaction import WriteSession
from app.quality.service import evaluation, quality, request_evaluation
from app.runs.service import described_run
from filter_core.evaluation.thresholds import Goal
from unghost.wire import quality as wire
from unghost.wire.runs import Run

evaluations_router = ApiRouter(prefix="/api/v1", tag="evaluations")


@evaluations_router.post(
    "/datasets/{dataset}/evaluations", status_code=202, response_model=Run
)
def create_evaluation(
    caller: Reviewer, dataset: DatasetName, session: WriteSession, services: AppServices
) -> Response:
    """Measure every channel that the frames' files allow; verdicts do not change."""
    dataset_row = DatasetRepository(session).named(dataset)
    run = request_evaluation(services, session, dataset_row, caller.name)
    return accepted(described_run(services, session, run))


@evaluations_router.get("/datasets/{dataset}/evaluations")
def get_evaluation(
    caller: Viewer,
    dataset: DatasetName,
    session: ReadSession,
    services: AppServices,
    query: Annotated[wire.EvaluationQuery, Query()],
) -> wire.Evaluation:
    """Precision, recall and F1 of every measured channel, from stored numbers."""
    dataset_row = DatasetRepository(session).named(dataset)
    return evaluation(services, session, dataset_row, query.truth)


@evaluations_router.put("/datasets/{dataset}/experiment")
def put_experiment(
    caller: Reviewer,
    dataset: DatasetName,
    body: wire.ExperimentIn,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> wire.Experiment:
    """Keep a report of `unghost worth-it` with the dataset, in place of the last."""
    require_room_to_write(services, session)
    repository = DatasetRepository(session)
    report = body.model_dump(mode="json")
    repository.change(repository.named(dataset), {"experiment": report})
    audit.note(AuditAction.DATASET_CHANGED, dataset, changed=["experiment"])
    return wire.Experiment.model_validate(report)


@evaluations_router.get("/datasets/{dataset}/experiment")
def get_experiment(
    caller: Viewer, dataset: DatasetName, session: ReadSession
) -> wire.Experiment:
    """The report that is kept with the dataset; 404 if there is none."""
    report = DatasetRepository(session).named(dataset).experiment
    existing(report, "experiment of dataset", dataset)
    return wire.Experiment.model_validate(report)


router = ApiRouter(prefix="/api/v1", tag="quality")


@router.get("/datasets/{dataset}/quality")
def get_quality(
    caller: Viewer,
    dataset: DatasetName,
    session: ReadSession,
    services: AppServices,
    query: Annotated[wire.QualityQuery, Query()],
) -> wire.Quality:
    """The filter compared with people or instances, agreement, suggested thresholds."""
    dataset_row = DatasetRepository(session).named(dataset)
    truth_and_goal = (query.truth, Goal(query.target, query.recall))
    return quality(services, session, dataset_row, truth_and_goal)
