"""Routes of exports: creating, watching, cancelling and downloading them."""

from __future__ import annotations

from typing import Annotated, Final

from fastapi import Query, Request, Response
from sqlalchemy.orm import Session

from app.access import service as access
from app.access.audit import AuditAction
from app.access.gate import Audited, counting_wrong_secrets
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db import tables
from app.db.pages import newest
from app.exports import service as exports
from app.exports.queries import VersionRepository
from app.http.deps import (
    AppServices,
    DatasetName,
    ReadSession,
    Reviewer,
    RowId,
    Viewer,
    make_room,
)
from app.http.files import RESUMABLE, file_of, file_response
from app.http.pages import NO_STORE, Newest, accepted, json_response
from app.http.routing import ApiRouter, OpenRouter
from app.http.transaction import WriteSession
from app.jobs.queries import job_with_id
from app.jobs.service import cancel
from app.jobs.stream import LastEventId, events_of, watch
from unghost.wire.model import Page
from unghost.wire.runs import DownloadLink, Export, ExportIn, Parts

router = ApiRouter(prefix="/api/v1", tag="exports")
downloads_router = OpenRouter(prefix="/api/v1", tag="exports")

_ARCHIVE: dict[int | str, dict[str, object]] = {
    **file_of(exports.MEDIA_TYPE),
    409: {"description": "The export is not finished, or its file was deleted."},
}


@router.get("/datasets/{dataset}/exports", response_model=Page[Export])
def list_exports(
    caller: Viewer, dataset: DatasetName, query: Newest, session: ReadSession
) -> Response:
    """Exports of a dataset, newest first."""
    dataset_row = DatasetRepository(session).named(dataset)
    rows = newest(session, tables.Export, dataset_row.id, query)
    return query.response(rows, lambda export: exports.describe_export(export, dataset))


@router.get("/datasets/{dataset}/versions", response_model=Page[Export])
def list_versions(
    caller: Viewer, dataset: DatasetName, query: Newest, session: ReadSession
) -> Response:
    """Versions of a dataset, that is, exports with a name, newest first."""
    dataset_row = DatasetRepository(session).named(dataset)
    rows = VersionRepository(session, dataset_row).page(query)
    return query.response(rows, lambda export: exports.describe_export(export, dataset))


@router.post("/datasets/{dataset}/exports", status_code=202, response_model=Export)
def create_export(
    caller: Reviewer,
    dataset: DatasetName,
    body: ExportIn,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Start an export of labels; one with class numbers fixes the order of classes."""
    dataset_row = DatasetRepository(session).named(dataset)
    export = exports.request_export(services, session, dataset_row, body, audit.name)
    audit.note(
        AuditAction.EXPORT_CREATED, export.id, dataset=dataset, format=body.format
    )
    return accepted(exports.describe_export(export, dataset))


_SHARE: Final = r"(0|1|[01]?\.[0-9]{1,9})"


@router.get("/datasets/{dataset}/parts")
def get_parts(
    caller: Viewer,
    dataset: DatasetName,
    session: ReadSession,
    split: Annotated[
        str,
        Query(
            pattern=rf"^({_SHARE}(,{_SHARE}){{0,2}})?$",
            description="Shares of train, val and test as `0.8,0.1,0.1`; as the option "
            "of an export.",
        ),
    ] = "",
) -> Parts:
    """The frames and sequences of each part, as an export with this `split` has them.

    Frames that an export leaves out, as those without an image, are counted here.
    """
    dataset_row = DatasetRepository(session).named(dataset)
    shares = [float(share) for share in split.split(",") if share]
    return exports.planned_parts(session, dataset_row, shares)


@router.post("/exports/{export_id}/cancel", status_code=202, response_model=Export)
def stop_export(
    caller: Reviewer,
    export_id: RowId,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Cancel an export; 409 if it has ended already."""
    export = cancel(services, session, exports.EXPORTS, export_id)
    dataset = DatasetRepository(session).with_id(export.dataset_id).name
    audit.note(AuditAction.EXPORT_CANCELLED, export_id, dataset=dataset)
    return accepted(exports.describe_export(export, dataset))


@router.delete("/exports/{export_id}", status_code=204)
def delete_export(
    caller: Reviewer,
    export_id: RowId,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Delete an export and its file; 409 if it has not ended."""
    exports.delete_export(audit, services, export_id)
    make_room(services, session)
    return Response(status_code=204)


@router.get("/exports/{export_id}")
def get_export(caller: Viewer, export_id: RowId, session: ReadSession) -> Export:
    """An export and its progress."""
    export = job_with_id(session, tables.Export, export_id)
    dataset = DatasetRepository(session).with_id(export.dataset_id)
    return exports.describe_export(export, dataset.name)


@router.get(
    "/exports/{export_id}/events",
    response_class=Response,
    responses=events_of(Export, "export"),
)
async def watch_export(
    caller: Viewer,
    export_id: RowId,
    request: Request,
    services: AppServices,
    last_event_id: LastEventId = None,
) -> Response:
    """The progress of an export, as server-sent events; the last one is `end`."""
    return await watch(request, services, exports.EXPORTS, export_id, last_event_id)


@router.get(
    "/exports/{export_id}/download",
    response_class=Response,
    responses=_ARCHIVE,
    openapi_extra=RESUMABLE,
)
def download_export(
    caller: Viewer,
    export_id: RowId,
    request: Request,
    session: ReadSession,
    services: AppServices,
) -> Response:
    """The archive of a finished export; a download can be resumed by ranges."""
    return _archive(request, session, services, export_id)


@router.post(
    "/exports/{export_id}/download-links", status_code=201, response_model=DownloadLink
)
def create_download_link(
    caller: Viewer, export_id: RowId, session: WriteSession, services: AppServices
) -> Response:
    """Create a link to this one file, for clients that cannot send a token (browsers).

    It is valid for five minutes, ranges included, and no longer than the token.
    """
    export = job_with_id(session, tables.Export, export_id)
    exports.finished_file(services, export)
    key, ends = access.make_link(session, caller.token_id, export_id)
    url = f"/api/v1/exports/{export_id}/file?key={key}"
    return json_response(DownloadLink(url=url, expires_at=ends), 201, NO_STORE)


@downloads_router.get(
    "/exports/{export_id}/file",
    response_class=Response,
    responses={
        **_ARCHIVE,
        401: {"description": "The link has expired, or belongs to another export."},
    },
    openapi_extra=RESUMABLE,
)
def download_by_address(
    export_id: RowId,
    key: Annotated[str, Query(min_length=1, max_length=200)],
    request: Request,
    session: ReadSession,
    services: AppServices,
) -> Response:
    """The archive of a finished export, by a link of `download-links`."""
    with counting_wrong_secrets(request):
        access.check_link(session, key, export_id)
    return _archive(request, session, services, export_id)


def _archive(
    request: Request, session: Session, services: ServiceContext, export_id: int
) -> Response:
    export = job_with_id(session, tables.Export, export_id)
    dataset = DatasetRepository(session).with_id(export.dataset_id)
    blob = exports.finished_file(services, export)
    name = f"{dataset.name}-{export.format}-{export.id}.zip"
    return file_response(request, blob, export.sha256 or "", exports.MEDIA_TYPE, name)
