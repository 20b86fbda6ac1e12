"""Restores a backup into a new data folder, completely or not at all."""

from __future__ import annotations

import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from app.addresses import FOLDER
from app.db.migrate import head_revision, is_known
from app.maintenance import datafolder
from app.maintenance.backup import DATABASE, LABEL, BackupLabel, size_of, unpack
from app.package import migrations_dir
from app.settings import Settings
from app.storage import BLOBS, durable
from app.storage.base import BlobStore
from app.storage.room import free_bytes

TOGETHER: Final = 8
"""Concurrent uploads of files to a bucket."""


def is_older(label: BackupLabel) -> bool:
    """Whether the service will migrate the schema of a backup when it starts."""
    return label.schema != head_revision(migrations_dir())


def restore(
    settings: Settings, backup: Path, steps: datafolder.Steps
) -> tuple[BackupLabel, int]:
    """Unpack a backup into an empty folder; each file is checked while it is copied.

    Returns its label and how many files it has. Raises CannotMaintain if the folder is
    not empty, the backup is damaged or of a newer version, or fewer than
    `min_free_bytes` would be free after it.
    """
    if settings.database_url is not None:
        raise datafolder.CannotMaintain(
            "a backup holds a SQLite database, and UNGHOST_DATABASE_URL names another "
            "one: unset it, or restore what `pg_dump` saved with `pg_restore`"
        )
    if not backup.exists():
        raise datafolder.CannotMaintain(f"{backup} does not exist")
    data = settings.data.absolute()
    _check_empty(data)
    with datafolder.stored_files_of(settings) as store:
        bucket = None if settings.storage == FOLDER else store
        if bucket is not None:
            bucket.check()
        durable.make_folder(data)
        _remove_unfinished(data)
        # Before anything is written that the disk has no room for.
        needed, free = size_of(backup), free_bytes([data])
        if free - needed < settings.min_free_bytes:
            raise datafolder.CannotMaintain(
                f"{backup} needs {needed} bytes, and {free} are free on the disk of "
                f"{data}, of which {int(settings.min_free_bytes)} have to stay free "
                "(UNGHOST_MIN_FREE_BYTES)"
            )
        inside = data / datafolder.RESTORING
        inside.mkdir(mode=0o700)
        try:
            with steps("restore", "MB") as advance:
                label, files = unpack(backup, inside, advance, keep=True)
            if not is_known(migrations_dir(), label.schema):
                raise datafolder.CannotMaintain(
                    f"{backup} cannot be used: {datafolder.newer(label.schema)}"
                )
            _put_in_place(inside, data, bucket, steps)
        finally:
            _remove_unfinished(data)
            durable.flush_folder(data)
    return label, files


def _check_empty(data: Path) -> None:
    # Left by an interrupted restore, by an emptied data folder, and by a file system.
    locks = {
        durable.MAINTENANCE_LOCK,
        durable.SERVER_LOCK,
        datafolder.database_lock(data / DATABASE).name,
    }
    left = {datafolder.RESTORING, *locks, "lost+found"}
    if data.exists() and not data.is_dir():
        raise datafolder.CannotMaintain(f"{data} is not a folder")
    names = [path.name for path in data.iterdir()] if data.is_dir() else []
    if _moved_only_files(data):
        left.add(BLOBS)
    if {*names} - left:
        raise datafolder.CannotMaintain(
            f"{data} is not empty; a backup is restored into an empty or new folder"
        )


def _moved_only_files(data: Path) -> bool:
    """Whether a restore ended after it had moved the files, and before the database."""
    inside = data / datafolder.RESTORING
    moved_or_removed = not any((inside / name).exists() for name in (BLOBS, LABEL))
    return moved_or_removed and (inside / DATABASE).exists()


def _remove_unfinished(data: Path) -> None:
    """Remove what a restore has unpacked, and files that it moved without a database.

    The folder with the unpacked database is removed last: it shows that these files are
    not those of a service.
    """
    if _moved_only_files(data):
        shutil.rmtree(data / BLOBS, ignore_errors=True)
    shutil.rmtree(data / datafolder.RESTORING, ignore_errors=True)


def _put_in_place(
    inside: Path, data: Path, bucket: BlobStore | None, steps: datafolder.Steps
) -> None:
    """Move the files and then the database: without it the service does not start."""
    (inside / BLOBS).mkdir(mode=0o700, exist_ok=True)
    durable.flush_file(inside / DATABASE)
    durable.flush_everything(inside)
    (inside / LABEL).unlink(missing_ok=True)
    if bucket is None:
        (inside / BLOBS).rename(data / BLOBS)
    else:
        # Every file, also those that exist there: they may be damaged.
        files = sorted((inside / BLOBS).glob("??/*"))
        names = {file.name for file in files}
        strangers = {file.digest for file in bucket.files()} - names
        if strangers:
            # With this database they would be garbage, and be deleted.
            raise datafolder.CannotMaintain(
                f"{len(strangers)} files there are not in the backup: they belong to "
                "another database, or are newer; choose another prefix in "
                "UNGHOST_STORAGE"
            )
        with (
            steps("upload the files", "files") as advance,
            ThreadPoolExecutor(TOGETHER) as pool,
        ):
            for done, _ in enumerate(pool.map(bucket.adopt, files), 1):
                advance(done, len(files))
    (inside / DATABASE).rename(data / DATABASE)
