"""Configurations of a dataset, and what another one would decide."""

from __future__ import annotations

from typing import Annotated

from fastapi import Path, Response

from app.access.audit import Act
from app.access.gate import Audited
from app.http.deps import (
    AppServices,
    CurrentPrincipal,
    DatasetName,
    ReadSession,
    WriteSession,
)
from app.http.pages import Newest, accepted, written
from app.http.routing import ApiRouter
from app.measuring.active import active_version, add_version, describe_version
from app.measuring.queries import ConfigRepository, DatasetRepository
from app.routes.config_body import ConfigBody, described_config
from app.runs.flips import PreviewLimits, preview
from app.services.run_requests import RunRequest, request_run
from app.services.run_states import described_run
from filter_core.config.filter import FilterConfig
from unghost.wire.model import Page
from unghost.wire.runs import ActivateIn, ConfigVersion, Preview, PreviewIn, Run

router = ApiRouter(prefix="/api/v1", tag="configs")


@router.get("/datasets/{dataset}/configs", response_model=Page[ConfigVersion])
def list_configs(
    dataset: DatasetName, wanted: Newest, session: ReadSession
) -> Response:
    """Versions of a dataset's configuration, newest first."""
    found = DatasetRepository(session).named(dataset)
    rows = ConfigRepository(session).page(found.id, wanted.page)
    return wanted.answer(rows, lambda version: describe_version(found, version))


@router.post(
    "/datasets/{dataset}/configs",
    status_code=201,
    response_model=ConfigVersion,
    responses={200: {"model": ConfigVersion, "description": "Stored already."}},
    openapi_extra=described_config(),
)
def create_config(
    dataset: DatasetName,
    body: ConfigBody,
    session: WriteSession,
    principal: CurrentPrincipal,
) -> Response:
    """Store a version; it decides nothing before a run applies it."""
    found = DatasetRepository(session).named(dataset)
    version, created = add_version(
        session,
        found,
        body.config,
        author=principal.name,
        unused_keys=body.unused_keys,
    )
    where = {"Location": f"/api/v1/configs/{version.digest}"}
    return written(describe_version(found, version), 201 if created else 200, where)


@router.get("/configs/{digest}")
def get_config(
    digest: Annotated[str, Path(pattern="^[0-9a-f]{64}$")], session: ReadSession
) -> ConfigVersion:
    """A version by its digest."""
    version = ConfigRepository(session).with_digest(digest)
    dataset = DatasetRepository(session).with_id(version.dataset_id)
    return describe_version(dataset, version)


@router.get("/datasets/{dataset}/config")
def get_active_config(dataset: DatasetName, session: ReadSession) -> ConfigVersion:
    """The version that decides now."""
    found = DatasetRepository(session).named(dataset)
    return describe_version(found, active_version(session, found))


@router.put("/datasets/{dataset}/config", status_code=202, response_model=Run)
def activate_config(
    dataset: DatasetName,
    body: ActivateIn,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Make a version the active one, through a run."""
    found = DatasetRepository(session).named(dataset)
    wanted = RunRequest(body.digest, audit.name, activate=True)
    run = request_run(services, session, found, wanted)
    audit.note(Act.CONFIG_ACTIVATED, dataset, config=body.digest, run=run.id)
    return accepted(described_run(services, session, run))


@router.post("/datasets/{dataset}/preview")
def preview_config(
    dataset: DatasetName, body: PreviewIn, session: ReadSession, services: AppServices
) -> Preview:
    """What a configuration would decide; nothing is written, no pixel is read."""
    found = DatasetRepository(session).named(dataset)
    config = FilterConfig.from_mapping(body.config.root)
    limits = PreviewLimits(flips=body.limit, bins=body.bins)
    return preview(services, session, found, config, limits)
