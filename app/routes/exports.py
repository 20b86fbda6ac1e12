"""Exports: labels written in the background, then downloaded."""

from __future__ import annotations

from typing import Any

from fastapi import Request, Response
from fastapi.responses import JSONResponse

from app.db.tables import Export
from app.deps import (
    AppServices,
    Audited,
    CurrentPrincipal,
    ReadSession,
    RowId,
    WriteSession,
)
from app.repositories.datasets import DatasetRepository
from app.repositories.runs import ExportRepository
from app.routes.blobs import file_response
from app.routes.datasets import DatasetName
from app.routes.event_stream import LastEventId, events_of, watch
from app.routes.newest_first import Newest
from app.routing import ApiRouter
from app.schemas.pages import Page
from app.schemas.pictures import RESUMABLE, file_of
from app.schemas.runs import ExportIn, ExportOut
from app.services.audit import Act
from app.services.export_writing import job_of
from app.services.exports import (
    MEDIA_TYPE,
    ExportRequest,
    cancel_export,
    describe_export,
    finished_file,
    request_export,
)

router = ApiRouter(prefix="/api/v1", tag="exports")

_ARCHIVE: dict[int | str, dict[str, Any]] = {
    **file_of(MEDIA_TYPE),
    409: {"description": "The export is not finished."},
}


@router.get("/datasets/{dataset}/exports", response_model=Page[ExportOut])
def list_exports(
    dataset: DatasetName, wanted: Newest, session: ReadSession
) -> Response:
    """Exports of a dataset, newest first."""
    found = DatasetRepository(session).named(dataset)
    rows = ExportRepository(session).page(found.id, wanted.page)
    return wanted.answer(rows, lambda export: describe_export(export, dataset))


@router.post("/datasets/{dataset}/exports", status_code=202, response_model=ExportOut)
def create_export(
    dataset: DatasetName,
    body: ExportIn,
    session: WriteSession,
    services: AppServices,
    principal: CurrentPrincipal,
) -> Response:
    """Write the labels of the dataset; its classes keep their order from now on."""
    found = DatasetRepository(session).named(dataset)
    wanted = ExportRequest(body.format, body.options.model_dump(), principal.name)
    export = request_export(services, session, found, wanted)
    return _accepted(export, dataset)


@router.post("/exports/{export_id}/cancel", status_code=202, response_model=ExportOut)
def stop_export(
    export_id: RowId, session: WriteSession, services: AppServices, audit: Audited
) -> Response:
    """End an export that is not over. 409 if it is over."""
    export = cancel_export(services, session, export_id)
    dataset = DatasetRepository(session).with_id(export.dataset_id).name
    audit.note(Act.EXPORT_CANCELLED, export_id, dataset=dataset)
    return _accepted(export, dataset)


def _accepted(export: Export, dataset: str) -> Response:
    return JSONResponse(
        describe_export(export, dataset),
        status_code=202,
        headers={"Location": f"/api/v1/exports/{export.id}"},
    )


@router.get("/exports/{export_id}", response_model=ExportOut)
def get_export(export_id: RowId, session: ReadSession) -> dict[str, Any]:
    """An export and how far it is."""
    export = ExportRepository(session).with_id(export_id)
    dataset = DatasetRepository(session).with_id(export.dataset_id)
    return describe_export(export, dataset.name)


@router.get(
    "/exports/{export_id}/events",
    response_class=Response,
    responses=events_of(ExportOut, "export"),
)
async def watch_export(
    export_id: RowId,
    request: Request,
    services: AppServices,
    last_event_id: LastEventId = None,
) -> Response:
    """How an export goes on, as server-sent events; the last one is `end`."""
    return await watch(request, services, job_of(export_id), last_event_id)


@router.get(
    "/exports/{export_id}/download",
    response_class=Response,
    responses=_ARCHIVE,
    openapi_extra=RESUMABLE,
)
def download_export(
    export_id: RowId, request: Request, session: ReadSession, services: AppServices
) -> Response:
    """The archive of a finished export; a download can be resumed by ranges."""
    export = ExportRepository(session).with_id(export_id)
    dataset = DatasetRepository(session).with_id(export.dataset_id)
    blob = finished_file(services, export)
    name = f"{dataset.name}-{export.format}-{export.id}.zip"
    return file_response(request, blob, export.sha256 or "", MEDIA_TYPE, name)
