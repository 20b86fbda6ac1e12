"""Creates the application from the settings, the routes and the middleware."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache, partial
from operator import attrgetter
from typing import Final

from fastapi import APIRouter, FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.routing import BaseRoute

from app.access.gate import TokenGate
from app.access.routes import audit_router, login_router, session_router, tokens_router
from app.boxes.routes import crops_router, frames_router
from app.boxes.routes import pictures_router as frame_pictures_router
from app.boxes.routes import router as boxes_router
from app.datasets.routes import router as datasets_router
from app.exports.routes import downloads_router
from app.exports.routes import router as exports_router
from app.hooks.routes import router as hooks_router
from app.http import middleware, openapi, problems
from app.http.admission import Admission
from app.http.idempotency import RepeatedRequest
from app.http.static import content_security_policy, description_router, files_router
from app.http.static import router as page_router
from app.http.transaction import repeat_response
from app.ingest.routes import folders_router, known_frames_router, upload_router
from app.ingest.routes import router as batches_router
from app.metrics import RequestMetrics
from app.ops.readiness import Readiness
from app.ops.routes import probes_router
from app.ops.routes import router as about_router
from app.package import VERSION, static_dir
from app.process.connections import Connections
from app.process.lifespan import running
from app.process.loop_watch import LoopWatch
from app.quality.routes import evaluations_router
from app.quality.routes import router as quality_router
from app.review.routes import history_router, queue_router
from app.review.routes import router as reviews_router
from app.runs.routes import configs_router
from app.runs.routes import router as runs_router
from app.settings import Settings

ROUTERS: Final = (
    audit_router,
    batches_router,
    boxes_router,
    history_router,
    crops_router,
    configs_router,
    datasets_router,
    evaluations_router,
    exports_router,
    downloads_router,
    folders_router,
    hooks_router,
    frame_pictures_router,
    upload_router,
    frames_router,
    probes_router,
    about_router,
    known_frames_router,
    page_router,
    files_router,
    description_router,
    quality_router,
    queue_router,
    reviews_router,
    runs_router,
    login_router,
    session_router,
    tokens_router,
)
"""In the order of the OpenAPI document; the first route that matches is used."""


_NAME: Final = attrgetter("name")


@cache
def routes() -> tuple[BaseRoute, ...]:
    """The routes of all applications of this process.

    FastAPI takes long to prepare them, which it does when they are first matched.
    """
    together = APIRouter(generate_unique_id_function=_NAME)
    for router in ROUTERS:
        together.include_router(router)
    return tuple(together.routes)


def create_app(settings: Settings | None = None) -> FastAPI:
    """The application; its database and pools are opened when the server starts it."""
    settings = settings or Settings()
    metrics = RequestMetrics(VERSION)
    policy = content_security_policy(static_dir() / "index.html")
    app = FastAPI(
        title="Unghost",
        version=VERSION,
        summary="Finds the boxes that CARLA's camera cannot see, and explains why.",
        lifespan=_lifespan,
        middleware=[
            Middleware(middleware.RequestId),
            Middleware(middleware.AccessLog, metrics=metrics),
            Middleware(middleware.SecurityHeaders, content_security_policy=policy),
            Middleware(middleware.Compression),
            Middleware(middleware.Problems),
            Middleware(middleware.NoNewWork),
            Middleware(middleware.KnownHosts, hosts=settings.served_hosts),
            Middleware(middleware.BodyLimit, wait_s=settings.body_wait_s),
        ],
        redirect_slashes=False,
        generate_unique_id_function=_NAME,
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
    )
    app.state.settings, app.state.metrics = settings, metrics
    app.state.connections = Connections.of(settings)
    app.state.gate = TokenGate()
    problems.install(app)
    app.add_exception_handler(RepeatedRequest, repeat_response)
    app.router.routes.extend(routes())
    app.openapi = partial(openapi.document, app)  # type: ignore[method-assign]  # FastAPI's own way
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    # Opening and closing block (migrations, waiting for work to stop): off the loop.
    lifetime = running(app.state.settings)
    watch = LoopWatch()
    app.state.readiness = Readiness(watch)
    with watch.watching():
        try:
            services = await run_in_threadpool(lifetime.__enter__)
        except Exception as exc:
            app.state.failure = exc  # uvicorn reports only that startup failed
            raise
        services.keep(Admission(services.settings.workers))
        app.state.database, app.state.services = services.database, services
        try:
            yield
        finally:
            await run_in_threadpool(lifetime.__exit__, None, None, None)
