"""Making a data folder of a backup, or nothing at all."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.db.migrate import head_revision, is_known
from app.resources import migrations_dir
from app.services.backup_reading import DATABASE, LABEL, unpack
from app.services.data_folder import BLOBS, RESTORING, CannotMaintain, Steps, newer
from app.settings import Settings
from app.storage import flush_everything, flush_file, flush_folder, make_folder


@dataclass(frozen=True)
class Restored:
    """A data folder as it is now."""

    data: Path
    files: int
    schema: str
    created_at: str
    left_out: tuple[str, ...]

    @property
    def is_older(self) -> bool:
        """Whether the service changes its schema when it starts."""
        return self.schema != head_revision(migrations_dir())

    def as_dict(self) -> dict[str, Any]:
        """As it is printed."""
        return {**vars(self), "data": str(self.data)}


def restore(settings: Settings, backup: Path, steps: Steps) -> Restored:
    """Unpack a backup into an empty folder; each file is checked while it is copied.

    Raises
    ------
    CannotMaintain
        The folder is not empty, or the backup is not whole or from a newer version.
    """
    if settings.database_url is not None:
        raise CannotMaintain(
            "a backup holds a SQLite database, and UNGHOST_DATABASE_URL names another "
            "one: unset it, or restore what `pg_dump` saved with `pg_restore`"
        )
    if not backup.exists():
        raise CannotMaintain(f"there is no {backup}")
    data = settings.data.absolute()
    _check_empty(data)
    make_folder(data)
    inside = data / RESTORING
    shutil.rmtree(inside, ignore_errors=True)
    inside.mkdir(mode=0o700)
    try:
        with steps("restore", "MB") as advance:
            unpacked = unpack(backup, inside, advance, keep=True)
        label = unpacked.label
        if not is_known(migrations_dir(), label.schema):
            raise CannotMaintain(f"{backup} cannot be used: {newer(label.schema)}")
        _put_in_place(inside, data)
    finally:
        shutil.rmtree(inside, ignore_errors=True)
        flush_folder(data)
    return Restored(
        data, unpacked.files, label.schema, label.created_at, label.left_out
    )


def _check_empty(data: Path) -> None:
    # The lock of a folder that was emptied, and what an interrupted restore left.
    harmless = {RESTORING, ".maintenance.lock", "lost+found"}
    if data.exists() and not data.is_dir():
        raise CannotMaintain(f"{data} is no folder")
    found = [path.name for path in data.iterdir()] if data.is_dir() else []
    if {*found} - harmless:
        raise CannotMaintain(
            f"{data} is not empty; a backup is restored into an empty or new folder"
        )


def _put_in_place(inside: Path, data: Path) -> None:
    """Files first and the database last: without it nothing is served."""
    (inside / BLOBS).mkdir(mode=0o700, exist_ok=True)
    flush_file(inside / DATABASE)
    flush_everything(inside)
    (inside / LABEL).unlink(missing_ok=True)
    (inside / BLOBS).rename(data / BLOBS)
    (inside / DATABASE).rename(data / DATABASE)
