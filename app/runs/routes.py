"""Routes of configurations, previews and runs."""

from __future__ import annotations

from typing import Annotated, Final

from fastapi import Depends, Header, Path, Query, Request, Response

from app.access.audit import AuditAction
from app.access.gate import Audited
from app.catalog.configs import ConfigRepository
from app.catalog.datasets import DatasetRepository
from app.db import tables
from app.db.base import MAX_ID
from app.db.pages import newest
from app.errors import StaleConfig, UnsupportedMedia
from app.http import pages
from app.http.bodies import run_off_loop
from app.http.deps import (
    AppServices,
    DatasetName,
    ReadSession,
    Reviewer,
    RowId,
    Viewer,
    require_room_to_write,
)
from app.http.routing import ApiRouter, body_up_to
from app.http.transaction import WriteSession
from app.jobs.queries import job_with_id
from app.jobs.service import cancel
from app.jobs.stream import LastEventId, events_of, watch
from app.measuring.active import (
    active_config,
    active_version,
    add_version,
    describe_version,
)
from app.runs import service as runs
from app.runs.flips import compared_runs, preview, run_diff
from app.runs.queries import RunRepository
from filter_core.config.file import CARLASIMU_ROOT, LoadedConfig, load_config
from unghost.wire import runs as wire
from unghost.wire.datasets import FilterConfigIn
from unghost.wire.model import Page
from unghost.wire.words import JobState

_MEDIA_TYPES: Final = (
    "application/json",
    "application/yaml",
    "application/x-yaml",
    "text/yaml",
)


async def config_body(request: Request) -> LoadedConfig:
    """The configuration in the body; JSON is YAML as well."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip()
    if media_type.lower() not in _MEDIA_TYPES:
        raise UnsupportedMedia(
            "expected application/json or application/yaml, "
            f"found {media_type or 'no media type'!r}"
        )
    return await run_off_loop(request, await request.body(), load_config)


ConfigBody = Annotated[LoadedConfig, Depends(config_body)]


def described_config() -> dict[str, object]:
    """The body for the OpenAPI document."""
    schema = {
        "description": "The keys of filter.yaml, or carlasimu's boundingBox.yaml; "
        "every key is optional, and an empty body means all defaults.",
        "anyOf": [
            {"$ref": f"#/components/schemas/{FilterConfigIn.__name__}"},
            {
                "type": "object",
                "required": [CARLASIMU_ROOT],
                "properties": {CARLASIMU_ROOT: {"type": "object"}},
                "additionalProperties": False,
            },
            {"type": "null"},
        ],
    }
    content = {name: {"schema": schema} for name in _MEDIA_TYPES[:2]}
    body = {"requestBody": {"required": True, "content": content}}
    return {**body, **body_up_to("max_config_bytes")}


configs_router = ApiRouter(prefix="/api/v1", tag="configs")


@configs_router.get(
    "/datasets/{dataset}/configs", response_model=Page[wire.ConfigVersion]
)
def list_configs(
    caller: Viewer, dataset: DatasetName, query: pages.Newest, session: ReadSession
) -> Response:
    """Versions of a dataset's configuration, newest first."""
    dataset_row = DatasetRepository(session).named(dataset)
    rows = newest(session, tables.ConfigVersion, dataset_row.id, query)
    return query.response(rows, lambda version: describe_version(dataset_row, version))


@configs_router.post(
    "/datasets/{dataset}/configs",
    status_code=201,
    response_model=wire.ConfigVersion,
    responses={200: {"model": wire.ConfigVersion, "description": "Stored already."}},
    openapi_extra=described_config(),
)
def create_config(
    caller: Reviewer,
    dataset: DatasetName,
    body: ConfigBody,
    session: WriteSession,
    services: AppServices,
) -> Response:
    """Store a version; it has no effect until a run applies it."""
    require_room_to_write(services, session)
    dataset_row = DatasetRepository(session).named(dataset)
    version, created = add_version(
        session,
        dataset_row,
        body.after(active_config(session, dataset_row)),
        author=caller.name,
        unused_keys=body.unused_keys,
    )
    where = {"Location": f"/api/v1/configs/{version.digest}"}
    return pages.json_response(
        describe_version(dataset_row, version), 201 if created else 200, where
    )


@configs_router.get("/configs/{digest}")
def get_config(
    caller: Viewer,
    digest: Annotated[str, Path(pattern="^[0-9a-f]{64}$")],
    session: ReadSession,
) -> wire.ConfigVersion:
    """A version by its digest."""
    version = ConfigRepository(session).with_digest(digest)
    dataset = DatasetRepository(session).with_id(version.dataset_id)
    return describe_version(dataset, version)


@configs_router.get("/datasets/{dataset}/config")
def get_active_config(
    caller: Viewer, dataset: DatasetName, session: ReadSession, response: Response
) -> wire.ConfigVersion:
    """The active version, by which boxes are decided now; its `ETag` is the digest."""
    dataset_row = DatasetRepository(session).named(dataset)
    version = describe_version(dataset_row, active_version(session, dataset_row))
    response.headers["ETag"] = f'"{version.digest}"'
    return version


IfMatch = Annotated[
    str | None,
    Header(
        description="`ETag` of the active version: refused with 412 if another is or "
        "becomes active."
    ),
]


@configs_router.put(
    "/datasets/{dataset}/config", status_code=202, response_model=wire.Run
)
def activate_config(
    caller: Reviewer,
    dataset: DatasetName,
    body: wire.ActivateIn,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
    if_match: IfMatch = None,
) -> Response:
    """Make a version the active one, through a run.

    If the last open run will do that already, this returns it.
    """
    dataset_row = DatasetRepository(session).named(dataset)
    digest = body.digest
    if digest is None:
        config = body.config
        source = config.root if isinstance(config, FilterConfigIn) else config
        loaded = load_config(source or "")
        version, _ = add_version(
            session,
            dataset_row,
            loaded.after(active_config(session, dataset_row)),
            author=audit.name,
            unused_keys=loaded.unused_keys,
        )
        digest = version.digest
    run = runs.run_activating(session, dataset_row, digest)
    if run is None:
        if if_match is not None:
            coming = runs.coming_version(session, dataset_row)
            tags = [tag.strip() for tag in if_match.split(",")]
            if if_match.strip() != "*" and f'"{coming.digest}"' not in tags:
                raise StaleConfig(
                    f"configuration {coming.digest[:12]} of {coming.created_by!r} is "
                    f"or becomes the active one of dataset {dataset!r}, expected "
                    f"{if_match}",
                    current=describe_version(dataset_row, coming).model_dump(
                        mode="json"
                    ),
                )
        request = runs.RunRequest(digest, audit.name, activate=True)
        run = runs.request_run(services, session, dataset_row, request)
        made = {"config": digest, "run": run.id}
        audit.note(AuditAction.CONFIG_ACTIVATED, dataset, **made)
    return pages.accepted(runs.described_run(services, session, run))


@configs_router.post("/datasets/{dataset}/preview")
def preview_config(
    caller: Reviewer,
    dataset: DatasetName,
    body: wire.PreviewIn,
    session: ReadSession,
    services: AppServices,
) -> wire.Preview:
    """What a configuration would decide; writes nothing and reads no pixel."""
    dataset_row = DatasetRepository(session).named(dataset)
    return preview(services, session, dataset_row, body)


router = ApiRouter(prefix="/api/v1", tag="runs")


State = Annotated[
    JobState | None, Query(description="Only runs in this state.", examples=["running"])
]


@router.get("/datasets/{dataset}/runs", response_model=Page[wire.Run])
def list_runs(
    caller: Viewer,
    dataset: DatasetName,
    query: pages.Newest,
    session: ReadSession,
    services: AppServices,
    state: State = None,
) -> Response:
    """Runs of a dataset, newest first."""
    dataset_row = DatasetRepository(session).named(dataset)
    rows = RunRepository(session).page(query, state, dataset_row.id)
    return query.response(rows, runs.describing_runs(services, session, rows))


@router.get("/runs", response_model=Page[wire.Run])
def list_all_runs(
    caller: Viewer,
    query: pages.Newest,
    session: ReadSession,
    services: AppServices,
    state: State = None,
) -> Response:
    """Runs of all datasets, newest first."""
    rows = RunRepository(session).page(query, state)
    return query.response(rows, runs.describing_runs(services, session, rows))


@router.post("/datasets/{dataset}/runs", status_code=202, response_model=wire.Run)
def create_run(
    caller: Reviewer,
    dataset: DatasetName,
    body: wire.RunIn,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Decide again from numbers, or measure again, as the configuration needs."""
    dataset_row = DatasetRepository(session).named(dataset)
    config = body.config
    request = runs.RunRequest(
        config
        if isinstance(config, str)
        else load_config(config.root).after(active_config(session, dataset_row)),
        audit.name,
        activate=body.activate,
        measure_again=body.measure_again,
    )
    run = runs.request_run(services, session, dataset_row, request)
    described = runs.described_run(services, session, run)
    if run.activate:
        activated = {"config": described.config, "run": run.id}
        audit.note(AuditAction.CONFIG_ACTIVATED, dataset, **activated)
    return pages.accepted(described)


@router.get("/runs/{run_id}")
def get_run(
    caller: Viewer, run_id: RowId, session: ReadSession, services: AppServices
) -> wire.Run:
    """A run and its progress."""
    run = job_with_id(session, tables.Run, run_id)
    return runs.described_run(services, session, run)


@router.get(
    "/runs/{run_id}/events",
    response_class=Response,
    responses=events_of(wire.Run, "run"),
)
async def watch_run(
    caller: Viewer,
    run_id: RowId,
    request: Request,
    services: AppServices,
    last_event_id: LastEventId = None,
) -> Response:
    """The progress of a run, as server-sent events; the last one is `end`."""
    return await watch(request, services, runs.RUNS, run_id, last_event_id)


@router.post("/runs/{run_id}/cancel", status_code=202, response_model=wire.Run)
def stop_run(
    caller: Reviewer,
    run_id: RowId,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Cancel a run; its dataset does not change. 409 if the run has ended already."""
    run = cancel(services, session, runs.RUNS, run_id)
    described = runs.described_run(services, session, run)
    audit.note(AuditAction.RUN_CANCELLED, run_id, dataset=described.dataset)
    return pages.accepted(described)


@router.get(
    "/runs/{run_id}/diff",
    response_model=wire.Diff,
    responses={409: {"description": "One of the runs is not done."}},
)
def compare_runs(
    caller: Viewer,
    run_id: RowId,
    request: Request,
    session: ReadSession,
    services: AppServices,
    against: Annotated[
        int | None,
        Query(ge=1, le=MAX_ID, description="Another run; default: the former active."),
    ] = None,
    limit: pages.Limit = 100,
    cursor: pages.Cursor = None,
) -> Response:
    """Boxes whose verdicts differ between two runs, nearest to a threshold first."""
    pair = compared_runs(session, run_id, against)
    diff = run_diff(services, session, pair, limit, cursor)
    return pages.page_with_link(request, diff, diff.next_cursor)
