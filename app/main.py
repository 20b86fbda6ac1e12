"""Puts the service together: settings, routes, and what surrounds every request."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from functools import partial
from importlib import import_module
from pkgutil import iter_modules

from anyio import CapacityLimiter
from fastapi import APIRouter, FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware

from app import http_errors, openapi, routes
from app.bodies import MAX_READERS
from app.connections import Connections
from app.deps import MAX_BATCHES, MAX_UPLOADS, MAX_WRITERS
from app.draining import NoNewWork
from app.lifetime import running
from app.metrics import RequestMetrics
from app.middleware import (
    AccessLog,
    BodyLimit,
    KnownHosts,
    Problems,
    RequestId,
    SecurityHeaders,
)
from app.page_files import content_security_policy
from app.resources import static_dir
from app.routing import MAX_READS_PER_TOKEN, TokenPlaces, repeat_answer
from app.services.idempotency import AlreadyAnswered
from app.services.loop_watch import LoopWatch
from app.services.readiness import Readiness
from app.settings import Settings
from app.version import VERSION


def create_app(settings: Settings | None = None) -> FastAPI:
    """The service; what it keeps open is opened when the server starts it."""
    settings = settings or Settings()
    metrics = RequestMetrics(VERSION)
    app = FastAPI(
        title="Unghost",
        version=VERSION,
        summary="Finds the boxes that CARLA's camera cannot see, and explains why.",
        lifespan=_lifespan,
        middleware=_surroundings(settings, metrics),
        redirect_slashes=False,
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
    )
    app.state.settings, app.state.metrics = settings, metrics
    app.state.connections = Connections.of(settings)
    http_errors.install(app)
    app.add_exception_handler(AlreadyAnswered, repeat_answer)
    for router in _routers():
        app.include_router(router)
    app.openapi = partial(openapi.document, app)  # type: ignore[method-assign]  # FastAPI's own way
    return app


def _routers() -> Iterator[APIRouter]:
    """The `router` of each module of routes; those without one are shared by others."""
    for module in sorted(found.name for found in iter_modules(routes.__path__)):
        router = getattr(import_module(f"{routes.__name__}.{module}"), "router", None)
        if router is not None:
            yield router


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    # Opening and closing block (migrations, waiting for work to stop): off the loop.
    lifetime = running(app.state.settings)
    workers = app.state.settings.workers
    app.state.writers = CapacityLimiter(MAX_WRITERS)
    app.state.uploads = CapacityLimiter(MAX_UPLOADS + workers)
    app.state.batches = CapacityLimiter(MAX_BATCHES)
    app.state.readers = CapacityLimiter(MAX_READERS)
    app.state.reading = TokenPlaces(MAX_READS_PER_TOKEN)
    app.state.drawings = CapacityLimiter(workers + 1)
    app.state.drawing = TokenPlaces(workers)  # one place is left for somebody else
    watch = LoopWatch()
    app.state.readiness = Readiness(watch)
    with watch.watching():
        try:
            services = await run_in_threadpool(lifetime.__enter__)
        except Exception as exc:
            app.state.failure = exc  # a server only reports that there was one
            raise
        app.state.database, app.state.services = services.database, services
        try:
            yield
        finally:
            await run_in_threadpool(lifetime.__exit__, None, None, None)


def _surroundings(settings: Settings, metrics: RequestMetrics) -> list[Middleware]:
    policy = content_security_policy(static_dir() / "index.html")
    return [
        Middleware(RequestId),
        Middleware(AccessLog, metrics=metrics),
        Middleware(SecurityHeaders, content_security_policy=policy),
        Middleware(Problems),
        Middleware(NoNewWork),
        Middleware(KnownHosts, hosts=settings.served_hosts),
        Middleware(BodyLimit, wait_s=settings.body_wait_s),
    ]
