"""Routes for liveness, readiness, version and metrics."""

from __future__ import annotations

import platform
from itertools import chain

from fastapi import Request
from fastapi.responses import PlainTextResponse

from app.http.deps import AppServices, Viewer
from app.http.routing import ApiRouter, OpenRouter
from app.metrics import WORK, RequestMetrics, process_facts, prometheus_text
from app.ops.gauges import gauges
from app.ops.readiness import Readiness
from app.package import VERSION
from app.process.connections import Connections
from unghost.wire.access import Alive, Ready, Version

probes_router = OpenRouter(tag="health")
router = ApiRouter(tag="health")


@probes_router.get("/healthz")
async def healthz() -> Alive:
    """The process is alive; nothing else is checked."""
    return Alive(status="ok")


@probes_router.get("/readyz")
async def readyz(request: Request, services: AppServices) -> Ready:
    """The service can store data and is not stopping; else 503 with the reasons."""
    readiness: Readiness = request.app.state.readiness
    return Ready(ready=True, checks=dict(await readiness.check(services)))


@router.get("/version")
async def running_version(caller: Viewer) -> Version:
    """The version of the service and of its API."""
    return Version(version=VERSION, api="v1", python=platform.python_version())


@router.get("/metrics", response_class=PlainTextResponse)
def metrics(
    caller: Viewer, request: Request, services: AppServices
) -> PlainTextResponse:
    """Metrics for Prometheus: requests, work, queues, verdicts and disk space."""
    counts: RequestMetrics = request.app.state.metrics
    connections: Connections = request.app.state.connections
    every = chain(
        counts.registry.collect(),
        connections.metrics(),
        WORK.collect(),
        gauges(services),
        process_facts(),
    )
    prometheus = "text/plain; version=0.0.4; charset=utf-8"
    return PlainTextResponse(prometheus_text(every), media_type=prometheus)
