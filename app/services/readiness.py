"""Whether this process can take work: database, schema, room on the disk."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from typing import Final

from sqlalchemy.exc import SQLAlchemyError

from app.db.engine import Database
from app.db.migrate import current_revision, head_revision
from app.errors import Fault, NotReady
from app.logs import error_log
from app.resources import migrations_dir
from app.settings import Settings

RETRY_S: Final = 5


def check(settings: Settings, database: Database) -> Mapping[str, str]:
    """What each check found, all of them well.

    Raises
    ------
    NotReady
        With one fault per check that failed.
    """
    checks: Mapping[str, Callable[[], str]] = {
        "database": lambda: _database_takes_writes(database),
        "migrations": lambda: _schema_is_current(database),
        "disk": lambda: _disk_has_room(settings),
    }
    found: dict[str, str] = {}
    faults: list[Fault] = []
    for name, run in checks.items():
        try:
            found[name] = run()
        except (NotReady, SQLAlchemyError, OSError) as exc:
            error_log.warning("not ready: %s", name, exc_info=exc)
            known = isinstance(exc, NotReady)
            faults.append(Fault("", name, str(exc) if known else "does not answer"))
    if faults:
        failed = "; ".join(f"{fault.code}: {fault.detail}" for fault in faults)
        raise NotReady(failed, retry_after_s=RETRY_S, faults=faults)
    return found


def _database_takes_writes(database: Database) -> str:
    with database.write() as session:
        session.connection()  # takes the writer's place, and gives it back
    return "takes writes"


def _schema_is_current(database: Database) -> str:
    current, head = current_revision(database.engine), head_revision(migrations_dir())
    if current != head:
        raise NotReady(f"the schema is at {current}, this version needs {head}")
    return f"at {current}"


def _disk_has_room(settings: Settings) -> str:
    free = shutil.disk_usage(settings.data).free
    if free < settings.min_free_bytes:
        raise NotReady(
            f"{free} bytes are free, {int(settings.min_free_bytes)} are needed"
        )
    return f"{free} bytes free"
