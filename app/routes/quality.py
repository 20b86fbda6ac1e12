"""The filter against people, and people against each other."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query

from app.http.deps import AppServices, ReadSession
from app.http.routing import ApiRouter
from app.repositories.datasets import DatasetRepository
from app.routes.datasets import DatasetName
from app.services.quality import quality
from filter_core.evaluation.thresholds import Goal
from unghost.wire.quality import Quality, QualityQuery

router = ApiRouter(prefix="/api/v1", tag="quality")


@router.get("/datasets/{dataset}/quality")
def get_quality(
    dataset: DatasetName,
    session: ReadSession,
    services: AppServices,
    query: Annotated[QualityQuery, Query()],
) -> Quality:
    """The filter against people or instances, agreement, suggested thresholds."""
    found = DatasetRepository(session).named(dataset)
    asked = (query.truth, Goal(query.target, query.recall))
    return quality(services, session, found, asked)
