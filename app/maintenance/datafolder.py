"""The data folder and its files, as commands other than the server find them."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Final

from sqlalchemy import Engine
from sqlalchemy import exc as sql

from app.addresses import FOLDER, bucket_of
from app.db.engine import Database
from app.db.inspection import copy_database, sqlite_file
from app.db.migrate import current_revision, head_revision, is_known
from app.errors import StorageAway
from app.maintenance.queries import StoredFileRepository
from app.package import migrations_dir
from app.settings import Settings
from app.storage import (
    BLOBS,
    BlobStore,
    FolderInUse,
    MissingLibrary,
    alone_in,
    endpoint_of,
    flush_file,
    flush_folder,
    open_store,
)

_PRIVATE: Final = 0o600
RESTORING: Final = ".restoring"
"""Holds a restore until it is complete."""

Advance = Callable[[int, "int | None"], None]
Steps = Callable[[str, str], AbstractContextManager[Advance]]
"""Opens a progress bar: what is done, and the unit it is counted in."""


class CannotMaintain(Exception):
    """A command cannot do what was asked of it; the text says why and what to do."""


def database_file(settings: Settings) -> Path | None:
    """The file of the database; None if it is on a server."""
    return sqlite_file(settings.sqlalchemy_url)


def check_usable(settings: Settings, engine: Engine, store: BlobStore) -> None:
    """Refuse to open, as the service, what would hide or destroy what is there.

    Raises
    ------
    CannotMaintain
        The database is gone while its files are there, was half restored, or belongs
        to a newer version.
    """
    file = database_file(settings)
    # Asked for, a database that is not there would be made.
    there = file is None or file.exists()
    revision = current_revision(engine) if there else None
    if revision is None and (settings.data / RESTORING).exists():
        raise CannotMaintain(
            f"a restore into {str(settings.data)!r} was interrupted; "
            "run `unghost restore` again"
        )
    if revision is None and any(store.files()):
        raise CannotMaintain(_files_alone(settings))
    if revision is not None and not is_known(migrations_dir(), revision):
        raise CannotMaintain(newer(revision))


def _files_alone(settings: Settings) -> str:
    if settings.storage == FOLDER:
        return (
            f"the database of {str(settings.data)!r} is missing, but its files are "
            "there; put it back, restore a backup into another folder, or begin anew "
            "in another folder"
        )
    return (
        f"there are files in {settings.storage}, but the database is new: what it does "
        "not know of would be cleared away; name the database that they belong to, "
        "restore its backup, or choose another prefix in UNGHOST_STORAGE"
    )


def keep_private(settings: Settings) -> None:
    """Let only its owner read the database, even if others may list its folder.

    It is made here because SQLite would let everybody read it; the log beside it gets
    the same mode as itself.
    """
    file = database_file(settings)
    if file is None:
        return
    # One that is there is not opened: closing it would end the locks by which SQLite's
    # own connections of this process keep others from clearing its log away.
    with suppress(FileExistsError):
        os.close(os.open(file, os.O_RDWR | os.O_CREAT | os.O_EXCL, _PRIVATE))
    for path in (file, *(file.with_name(file.name + end) for end in ("-wal", "-shm"))):
        with suppress(FileNotFoundError, PermissionError):  # another user's stays so
            path.chmod(_PRIVATE)


def check_same_version(settings: Settings, engine: Engine) -> None:
    """Refuse to work on a database that no service of this version has prepared.

    Raises
    ------
    CannotMaintain
        It is not there, or of another version.
    """
    file = database_file(settings)
    there = file is None or file.exists()
    revision = current_revision(engine) if there else None
    wanted = head_revision(migrations_dir())
    if revision is None:
        raise CannotMaintain(
            "there is no database of Unghost where the settings say (UNGHOST_DATA, "
            "UNGHOST_DATABASE_URL); start the service first"
        )
    if revision != wanted:
        raise CannotMaintain(
            f"the database is at schema {revision}, this version needs {wanted}: run "
            "the service and its workers from the same version"
        )


def newer(revision: str) -> str:
    """What to say of a database that this version does not know."""
    return (
        f"the database is at schema {revision}, this version knows only up to "
        f"{head_revision(migrations_dir())}: a newer Unghost wrote it; install that "
        "one, or restore a backup from before"
    )


@contextmanager
def opened(settings: Settings) -> Iterator[Database]:
    """The database of an existing data folder, at the schema of this version.

    Raises
    ------
    CannotMaintain
        There is none, or it is at another schema.
    """
    file = database_file(settings)
    if file is not None and not file.is_file():
        raise CannotMaintain(no_database(settings))
    database = Database(settings.sqlalchemy_url)
    try:
        try:
            revision = current_revision(database.engine)
        except sql.DatabaseError as exc:
            raise CannotMaintain(
                f"the database cannot be read: {exc.orig}; `unghost doctor` says more"
            ) from exc
        if revision is None or not is_known(migrations_dir(), revision):
            raise CannotMaintain(newer(revision) if revision else no_database(settings))
        if revision != head_revision(migrations_dir()):
            raise CannotMaintain(
                f"the database is at schema {revision}; start `unghost serve` once, "
                "which brings it up to date"
            )
        yield database
    finally:
        database.close()


def no_database(settings: Settings) -> str:
    """What to say of a folder, or a server's database, that nobody has served yet."""
    if database_file(settings) is None:
        return "the database is empty; start `unghost serve` once, which fills it"
    return (
        f"there is no database in {str(settings.data)!r}; name the data folder with "
        "--data DIR or UNGHOST_DATA"
    )


@contextmanager
def alone(settings: Settings) -> Iterator[None]:
    """Hold the data folder against other backups and collections of garbage."""
    try:
        with alone_in(settings.data):
            yield
    except (FileNotFoundError, NotADirectoryError) as exc:
        raise CannotMaintain(
            f"there is no folder {str(settings.data)!r}; name the data folder with "
            "--data DIR or UNGHOST_DATA"
        ) from exc
    except FolderInUse as exc:
        raise CannotMaintain(
            "a backup, or a collection of garbage, is at work already in "
            f"{str(settings.data)!r}; try again when it is over"
        ) from exc


_KEYS: Final = (
    "the credentials are refused ({}); see AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
)
_REFUSED: Final = (
    "AccessDenied",
    "InvalidAccessKeyId",
    "SignatureDoesNotMatch",
    "InvalidToken",
    "ExpiredToken",
    "PermissionDeniedError",
    "UnauthenticatedError",
)
_ELSEWHERE: Final = ("PermanentRedirect", "AuthorizationHeaderMalformed")
_REASONS: Final = {
    "NoSuchBucket": "there is no such bucket; make it, or mend UNGHOST_STORAGE",
    "NoKeys": "there are no keys for it; set AWS_ACCESS_KEY_ID and "
    "AWS_SECRET_ACCESS_KEY",
    "NotImplemented": "it cannot put something only if it is not there "
    "(`If-None-Match: *`)",
    "GenericError": "it does not answer",
    **dict.fromkeys(_ELSEWHERE, "it is in another region; see UNGHOST_STORAGE_REGION"),
    **{reason: _KEYS.format(reason) for reason in _REFUSED},
}


@contextmanager
def stored_files_of(settings: Settings) -> Iterator[BlobStore]:
    """The store of the files, for a command; it asks, makes and changes nothing yet.

    Raises
    ------
    CannotMaintain
        The store cannot be used, or does not answer any more.
    """
    with usable_store(settings):
        store = open_store(settings)
        try:
            yield store
        finally:
            store.close()


@contextmanager
def usable_store(settings: Settings) -> Iterator[None]:
    """Say of a store that cannot be used which one it is, and why."""
    try:
        yield
    except MissingLibrary as exc:
        raise CannotMaintain(str(exc)) from exc
    except StorageAway as exc:
        raise CannotMaintain(no_store(settings, exc)) from None


def check_moved(settings: Settings, database: Database, store: BlobStore) -> None:
    """Refuse a bucket without any of the files that the database refers to.

    Raises
    ------
    CannotMaintain
        Somebody named another place for files, and left them where they were.
    """
    if settings.storage == FOLDER:
        return
    with database.read() as session:
        if not StoredFileRepository(session).any_of_frames():
            return
    if not any(store.files()):
        raise CannotMaintain(
            f"the database refers to files, and none is in {settings.storage}: copy "
            f"them there from where they are (as {str(settings.data / BLOBS)!r}), or "
            "mend UNGHOST_STORAGE"
        )


def no_store(settings: Settings, away: StorageAway) -> str:
    """What to say of a bucket that does not answer as it should; no secret is in it."""
    bucket = bucket_of(settings.storage)
    name = settings.storage if bucket is None else bucket.name
    return (
        f"the bucket {name!r} at {endpoint_of(settings)} cannot be used: "
        f"{_REASONS.get(away.reason, away.reason)}"
    )


_ROOM: Final = 3
"""A migration needs the copy, its log and its changes: each a database at most."""

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
