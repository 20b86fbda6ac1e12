"""A copy of the database from before its schema is changed."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path
from typing import Final

from sqlalchemy import Engine

from app.db.inspection import copy_database
from app.db.migrate import current_revision, head_revision
from app.resources import migrations_dir
from app.services.data_folder import database_file
from app.settings import Settings
from app.storage import flush_file, flush_folder

_ROOM: Final = 3
"""The copy, the log of the migration, and what it changes: each a database at most."""

log = logging.getLogger(__name__)


def keep_before_migrating(settings: Settings, engine: Engine) -> Path | None:
    """Copy a SQLite database that is about to be migrated; where to, or None.

    A migration is one transaction, so a crash needs no copy. It is for going back to
    the version before, and not made where there is no room for it.
    """
    file, revision = database_file(settings), current_revision(engine)
    if file is None or revision in (None, head_revision(migrations_dir())):
        return None
    size = file.stat().st_size
    if shutil.disk_usage(file.parent).free < _ROOM * size + settings.min_free_bytes:
        log.warning("no room for a copy of the database at schema %s", revision)
        return None
    copy = file.with_name(f"{file.name}.schema-{revision}")
    draft = copy.with_name(f"{copy.name}.partial")
    draft.unlink(missing_ok=True)
    copy_database(file, draft, lambda _done, _total: None)
    draft.chmod(0o600)
    flush_file(draft)
    draft.replace(copy)
    flush_folder(copy.parent)
    log.warning("the database at schema %s is kept as %s", revision, copy.name)
    return copy
