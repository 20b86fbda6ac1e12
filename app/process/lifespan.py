"""Opens the resources of a process at startup, and closes them at shutdown."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import partial

from app.access.first_token import ensure_first_token
from app.access.gate import keeping_tokens
from app.addresses import LOCAL_ENGINE
from app.background import Task, repeating
from app.context import ServiceContext
from app.db.engine import Database, migrating_alone
from app.db.migrate import migrate
from app.engine.children import PixelPool, Subject
from app.engine.cluster import ClusterEngine, Scheduler
from app.engine.dask import Certificates
from app.engine.local import LocalEngine
from app.exports.service import EXPORTS
from app.hooks.delivery import delivering
from app.hooks.queries import job_ended
from app.http.admission import MAX_FOLDERS
from app.http.idempotency import forget_old_responses
from app.incoming import OpenBodies
from app.jobs.kind import register
from app.jobs.leases import running_watchdog
from app.jobs.queries import call_at_end, installation_id
from app.jobs.service import start
from app.maintenance import datafolder
from app.maintenance.removals import removing
from app.maintenance.sqlite_check import checking_for_damage
from app.measuring.active import DefaultConfig
from app.memory import LOOK_EVERY_S, IdleTrim
from app.package import migrations_dir
from app.runs.activate import refresh_doubt
from app.runs.service import RUNS
from app.settings import Settings
from app.storage import open_store
from app.storage.base import BlobStore
from app.storage.durable import make_folder
from app.storage.room import Reserve


@contextmanager
def running(settings: Settings) -> Iterator[ServiceContext]:
    """Migrate the data folder and open all resources; close them after the block."""
    register_kinds()
    make_folder(settings.data)
    Reserve(settings.data).give_up()
    default_config = DefaultConfig.of(settings)
    with datafolder.usable_store(settings):
        store = open_store(settings)
    database = Database(settings.sqlalchemy_url)
    try:
        with migrating_alone(database.engine), datafolder.usable_store(settings):
            datafolder.check_usable(settings, database.engine, store)
            datafolder.keep_private(settings)
            datafolder.keep_before_migrating(settings, database.engine)
            migrate(database.engine, migrations_dir())
        with database.write() as session:
            ensure_first_token(session, settings.token_file)
            forget_old_responses(session, timedelta(hours=settings.idempotency_hours))
        with datafolder.usable_store(settings):
            store.prepare()
            datafolder.check_moved(settings, database, store)
        if settings.engine == LOCAL_ENGINE:
            engine = LocalEngine(settings.workers)
        else:
            with database.read() as session:
                installation = installation_id(session)
            certificates = certificates_of(settings)
            scheduler = Scheduler(settings.engine, certificates, installation)
            engine = ClusterEngine(settings.workers, scheduler)
        services = _opened(settings, database, store, engine)
        services.keep(default_config)
        services.keep(OpenBodies(int(settings.max_open_body_bytes)))
        refresh_doubt(services)
        purpose = "return freed memory to the system"
        trimming = Task("memory", purpose, IdleTrim().look, LOOK_EVERY_S)
        try:
            with (
                running_watchdog(services, partial(start, services)),
                removing(services),
                checking_for_damage(services),
                keeping_tokens(services),
                delivering(services),
                repeating(services, trimming),
            ):
                yield services
        finally:
            services.close()
    finally:
        database.close()


@contextmanager
def attached(settings: Settings) -> Iterator[ServiceContext]:
    """Open the resources of a running service, for a worker; migrates nothing.

    Raises CannotMaintain: the database is missing, or its schema has another version.
    """
    register_kinds()
    with datafolder.usable_store(settings):
        store = open_store(settings)
    database = Database(settings.sqlalchemy_url)
    try:
        datafolder.check_same_version(settings, database.engine)
        engine = LocalEngine(settings.workers)
        services = _opened(settings, database, store, engine)
        try:
            yield services
        finally:
            services.close()
    finally:
        database.close()


def register_kinds() -> None:
    """Register all kinds of jobs in this process, and who is told of their ends."""
    register(RUNS, EXPORTS)
    call_at_end(job_ended)


def _opened(
    settings: Settings, database: Database, store: BlobStore, engine: LocalEngine
) -> ServiceContext:
    return ServiceContext(
        settings=settings,
        database=database,
        storage=store,
        engine=engine,
        pixels=pixel_pool(settings, settings.workers),
        drawers=pixel_pool(settings, settings.workers + 1),
        folders=folder_pool(settings),
    )


def certificates_of(settings: Settings) -> Certificates:
    """The certificate of this node, and the authority that it trusts."""
    return Certificates(settings.tls_ca, settings.tls_cert, settings.tls_key)


def pixel_pool(settings: Settings, children: int) -> PixelPool:
    """A pool of up to `children` child processes for pictures, started on demand."""
    return PixelPool(
        children,
        seconds=settings.max_pixel_seconds,
        memory_bytes=int(settings.max_pixel_memory_bytes),
        preload=("app.measuring.frame_files", "app.boxes.drawing"),
    )


def folder_pool(settings: Settings) -> PixelPool:
    """The pool of child processes that read dropped folders."""
    return PixelPool(
        MAX_FOLDERS,
        seconds=settings.max_folder_seconds,
        memory_bytes=int(settings.max_pixel_memory_bytes),
        preload=("app.ingest.folder",),
        subject=Subject("the folder", "UNGHOST_MAX_FOLDER_SECONDS"),
    )
