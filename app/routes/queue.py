"""The review queue: boxes to look at next, claimed so that nobody else gets them."""

from __future__ import annotations

from fastapi import Response

from app.http.deps import AppServices, CurrentPrincipal, WriteSession
from app.http.pages import written
from app.http.routing import ApiRouter
from app.repositories.datasets import DatasetRepository
from app.routes.datasets import DatasetName
from app.routes.selections import selection_of
from app.services.queue import QueueRequest, next_boxes, outlook
from unghost.wire.boxes import Queue, QueueIn

router = ApiRouter(prefix="/api/v1", tag="queue")


@router.post("/datasets/{dataset}/queue", response_model=Queue)
def take_from_queue(
    dataset: DatasetName,
    body: QueueIn,
    session: WriteSession,
    services: AppServices,
    principal: CurrentPrincipal,
) -> Response:
    """The next boxes to look at, claimed for five minutes; an answer ends the claim."""
    chosen = body.model_dump(exclude={"filters"})
    filters = selection_of(body.filters)
    wanted = QueueRequest(principal.name, selection=filters, **chosen)
    queue = outlook(services, dataset, wanted)
    found = DatasetRepository(session).named(dataset)
    return written(next_boxes(session, found, wanted, queue))
