"""What lives as long as the process: opened before the first request, closed after."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta

from app.db.engine import Database
from app.db.migrate import migrate
from app.engine import LocalEngine
from app.repositories.locks import migrating_alone
from app.resources import migrations_dir
from app.services import access
from app.services.context import ServiceContext
from app.services.data_folder import check_usable, keep_private
from app.services.export_jobs import start_exports
from app.services.idempotency import forget_old_answers
from app.services.runs import start_runs
from app.services.safety_copies import keep_before_migrating
from app.settings import Settings
from app.storage import FolderStorage, make_folder
from filter_core.config import FilterConfig
from filter_core.config_file import load_config
from filter_core.errors import FilterError


@contextmanager
def running(settings: Settings) -> Iterator[ServiceContext]:
    """Bring the data folder up to date, open everything, and close it at the end."""
    make_folder(settings.data)
    default_config = _default_config(settings)
    database = Database(settings.sqlalchemy_url)
    try:
        with migrating_alone(database.engine):
            check_usable(settings, database.engine)
            keep_private(settings)
            keep_before_migrating(settings, database.engine)
            migrate(database.engine, migrations_dir())
        with database.write() as session:
            access.ensure_first_token(session, settings.token_file)
            forget_old_answers(session, timedelta(hours=settings.idempotency_hours))
        services = ServiceContext(
            settings=settings,
            database=database,
            storage=FolderStorage(settings.data / "blobs"),
            engine=LocalEngine(settings.workers),
            default_config=default_config,
        )
        start_runs(services)
        start_exports(services)
        try:
            yield services
        finally:
            services.close()
    finally:
        database.close()


class UnusableConfig(Exception):
    """The configuration named in the settings cannot be read or is wrong."""


def _default_config(settings: Settings) -> FilterConfig:
    if settings.config is None:
        return FilterConfig()
    try:
        return load_config(settings.config.read_bytes()).config
    except OSError as error:
        reason = error.strerror or "it cannot be read"
        raise UnusableConfig(f"{settings.config}: {reason}") from error
    except FilterError as error:
        raise UnusableConfig(f"{settings.config}: {error}") from error
