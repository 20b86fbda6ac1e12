"""Routes of datasets and their statistics."""

from __future__ import annotations

from base64 import b64decode
from contextlib import suppress
from functools import partial
from typing import Annotated

from fastapi import Path, Query, Request, Response
from fastapi.exceptions import RequestValidationError

from app.access.audit import AuditAction
from app.access.gate import Audited
from app.catalog.datasets import DatasetRepository
from app.datasets import service as datasets
from app.datasets.classes import merge_class, remove_class, rename_class
from app.db.pages import name_of_cursor, newest
from app.db.tables import Problem
from app.errors import NotFound
from app.http.deps import (
    Admin,
    AppServices,
    DatasetName,
    ReadSession,
    Reviewer,
    Viewer,
    make_room,
    require_room_to_write,
)
from app.http.pages import Cursor, Limit, Newest, accepted, json_response, page_response
from app.http.routing import ApiRouter
from app.http.transaction import WriteSession
from app.measuring.active import DefaultConfig
from app.measuring.plan import DatasetReading
from app.runs.flips import current_histogram
from app.runs.service import described_run
from filter_core.config.filter import FilterConfig
from filter_core.images.header import read_image_header
from unghost.wire import datasets as wire
from unghost.wire.model import Page
from unghost.wire.runs import Run

router = ApiRouter(prefix="/api/v1", tag="datasets")


ClassName = Annotated[str, Path(max_length=200)]

Confirmation = Annotated[
    str | None, Query(description="The dataset's name again, as a confirmation.")
]


@router.get("/datasets", response_model=Page[wire.Dataset])
def list_datasets(
    caller: Viewer,
    request: Request,
    session: ReadSession,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> Response:
    """Datasets by name, with their counts."""
    after = name_of_cursor(cursor or "")
    rows = DatasetRepository(session).page(after=after, limit=limit + 1)
    items = [datasets.describe_dataset(session, row) for row in rows[:limit]]
    return page_response(request, items, items[-1].name if len(rows) > limit else None)


@router.post(
    "/datasets",
    status_code=201,
    response_model=wire.Dataset,
    responses={200: {"model": wire.Dataset, "description": "It exists (`exist_ok`)."}},
)
def create_dataset(
    caller: Reviewer,
    body: wire.DatasetIn,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
    exist_ok: Annotated[
        bool,
        Query(
            description="Return a dataset of this name as it is, whatever its settings "
            "are, instead of refusing to create it (409)."
        ),
    ] = False,
) -> Response:
    """Create a dataset, by default with the service's configuration."""
    if exist_ok:
        with suppress(NotFound):
            existing = DatasetRepository(session).named(body.name)
            return json_response(datasets.describe_dataset(session, existing))
    require_room_to_write(services, session)
    reading = DatasetReading(
        name=body.name,
        palette=body.palette,
        encoding=body.encoding,
        channel_order=body.channel_order,
        lossy_segmentation=body.lossy_segmentation,
        ignore_mask=_stored(body.ignore_mask),
    )
    first = services.one(DefaultConfig).config
    if body.config is not None:
        first = FilterConfig.from_mapping(body.config.root)
    new_dataset = datasets.NewDataset(
        reading,
        body.description,
        body.classes,
        first,
        audit.name,
        None if body.recording is None else body.recording.root,
        body.rule,
        body.coached,
    )
    dataset = datasets.create_dataset(session, new_dataset)
    audit.note(AuditAction.DATASET_CREATED, dataset.name)
    where = {"Location": f"/api/v1/datasets/{dataset.name}"}
    return json_response(datasets.describe_dataset(session, dataset), 201, where)


@router.get("/datasets/{dataset}", response_model=wire.Dataset)
def get_dataset(
    caller: Viewer, dataset: DatasetName, session: ReadSession
) -> wire.Dataset:
    """A dataset with its settings and counts."""
    dataset_row = DatasetRepository(session).named(dataset)
    return datasets.describe_dataset(session, dataset_row)


@router.patch(
    "/datasets/{dataset}",
    response_model=wire.Dataset,
    responses={202: {"model": Run, "description": "A run measures all frames again."}},
)
def change_dataset(
    caller: Reviewer,
    dataset: DatasetName,
    body: wire.DatasetPatch,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> wire.Dataset | Response:
    """Change a dataset; a change in how segmentations are read starts a run (202)."""
    dataset_row = DatasetRepository(session).named(dataset)
    changes = body.model_dump(exclude_unset=True)
    if body.ignore_mask is not None:
        require_room_to_write(services, session)
        changes["ignore_mask"] = _stored(body.ignore_mask)
    run = datasets.change_dataset(services, session, dataset_row, changes, audit.name)
    details = {"changed": sorted(changes), "run": run and run.id}
    audit.note(AuditAction.DATASET_CHANGED, dataset, **details)
    if run is None:
        return datasets.describe_dataset(session, dataset_row)
    return accepted(described_run(services, session, run))


@router.patch(
    "/datasets/{dataset}/classes/{name:any}", status_code=202, response_model=Run
)
def change_class(
    caller: Reviewer,
    dataset: DatasetName,
    name: ClassName,
    body: wire.ClassPatch,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Rename a class, or merge it into another, through a run that measures again."""
    dataset_row = DatasetRepository(session).named(dataset)
    rename = merge_class if body.name is None else rename_class
    other = body.name or str(body.merge_into)
    run = rename(services, audit, dataset_row, name, other)
    audit.note(
        AuditAction.DATASET_CHANGED,
        dataset,
        changed=["classes"],
        **body.model_dump(exclude_unset=True),
        former=name,
        run=run.id,
    )
    return accepted(described_run(services, session, run))


@router.delete("/datasets/{dataset}/classes/{name:any}", status_code=204)
def delete_class(
    caller: Reviewer,
    dataset: DatasetName,
    name: ClassName,
    session: WriteSession,
    audit: Audited,
) -> Response:
    """Remove a class without boxes; 409 with their number if it has any."""
    remove_class(session, DatasetRepository(session).named(dataset), name)
    changes = {"changed": ["classes"], "removed": name}
    audit.note(AuditAction.DATASET_CHANGED, dataset, **changes)
    return Response(status_code=204)


@router.delete("/datasets/{dataset}", status_code=204)
def delete_dataset(
    caller: Admin,
    dataset: DatasetName,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
    confirm: Confirmation = None,
) -> Response:
    """Delete a dataset with everything in it; `confirm` repeats its name."""
    datasets.remove_dataset(services, session, dataset, confirm)
    audit.note(AuditAction.DATASET_DELETED, dataset)
    make_room(services, session)
    return Response(status_code=204)


@router.get("/datasets/{dataset}/stats", response_model=wire.Stats)
def get_stats(caller: Viewer, dataset: DatasetName, session: ReadSession) -> wire.Stats:
    """The counts of a dataset, from its tallies."""
    return datasets.statistics(session, DatasetRepository(session).named(dataset))


@router.get("/datasets/{dataset}/histogram", response_model=wire.Histogram)
def get_histogram(
    caller: Viewer,
    dataset: DatasetName,
    session: ReadSession,
    services: AppServices,
    bins: Annotated[int, Query(ge=2, le=200)] = 50,
) -> wire.Histogram:
    """match_percent per class, with the thresholds of the active configuration."""
    dataset_row = DatasetRepository(session).named(dataset)
    return current_histogram(services, session, dataset_row, bins)


@router.get("/datasets/{dataset}/problems", response_model=Page[wire.RefusedFrame])
def list_problems(
    caller: Viewer, dataset: DatasetName, query: Newest, session: ReadSession
) -> Response:
    """Frames that were refused and have not been stored since, newest first."""
    dataset_row = DatasetRepository(session).named(dataset)
    rows = newest(session, Problem, dataset_row.id, query)
    refused = partial(wire.RefusedFrame.model_validate, from_attributes=True)
    return query.response(rows, refused)


def _stored(mask: wire.IgnoreMask | None) -> dict[str, object] | None:
    """An ignore mask as it is stored; a PNG must have a valid header."""
    if mask is None:
        return None
    if mask.png is not None:
        try:
            read_image_header(b64decode(mask.png, validate=True))
        except ValueError as exc:
            where = ("body", "ignore_mask", "png")
            fault = {"type": "value_error", "loc": where, "msg": str(exc)}
            raise RequestValidationError([fault]) from exc
    return mask.model_dump(exclude_none=True)
