"""Opens the data folder, its database and its storage, with checks, for commands."""

from __future__ import annotations

import logging
import os
import shlex
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
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
from app.storage import BLOBS, MissingLibrary, durable, endpoint_of, open_store
from app.storage.base import BlobStore

log = logging.getLogger(__name__)

_PRIVATE: Final = 0o600
_ROOT: Final = 0
"""The id of the user who can read and write everything anyway."""
RESTORING: Final = ".restoring"
"""Name of the folder that contains an incomplete restore."""

Advance = Callable[[int, "int | None"], None]
Steps = Callable[[str, str], AbstractContextManager[Advance]]
"""Opens a progress bar, given a description of the step and the unit of progress."""


class CannotMaintain(Exception):
    """A command cannot be executed; the text says why and what to do."""


def database_file(settings: Settings) -> Path | None:
    """The file of the database; None if it is on a server."""
    return sqlite_file(settings.sqlalchemy_url)


def database_lock(file: Path) -> Path:
    """The file beside a SQLite database that its server locks."""
    return file.with_name(f".{file.name}.lock")


def check_owner(settings: Settings) -> None:
    """Refuse a data folder in which others may have given themselves access.

    The folder, and each file in it that decides on access, has to belong to the user of
    this process or to root, and so has the link, if it is one. The group may write to
    it, as to volumes of Kubernetes, but not everybody. Otherwise CannotMaintain is
    raised.
    """
    if os.name == "nt":  # files have no such owners and modes
        return
    files = [settings.data / durable.SERVER_LOCK, settings.token_file]
    database = database_file(settings)
    if database is not None:
        ends = ("", "-wal", "-shm", "-journal")
        files += (database.with_name(database.name + end) for end in ends)
        files.append(database_lock(database))
    for path in (settings.data, *files):
        what = "the data folder" if path == settings.data else "the file"
        with suppress(FileNotFoundError):
            _check_owner(what, path, path.lstat())
            _check_owner(what, path.resolve(), path.stat())


def _check_owner(what: str, path: Path, state: os.stat_result) -> None:
    me, quoted = os.geteuid(), shlex.quote(str(path))
    if state.st_uid not in (me, _ROOT):
        raise CannotMaintain(
            f"{what} {str(path)!r} belongs to another user (uid {state.st_uid}), who "
            "may know valid tokens: --data chooses another folder, or, if you trust "
            f"that user, `chown -hR {me} {quoted}` makes it yours"
        )
    if stat.S_ISLNK(state.st_mode) or not state.st_mode & stat.S_IWOTH:
        return
    advice = "--data chooses another folder"
    if stat.S_ISDIR(state.st_mode):
        new = shlex.quote(str(path / "unghost-data"))
        advice = f"--data {new} makes a new one in it"
    if not state.st_mode & stat.S_ISVTX:  # as /tmp has it, which stays as it is
        advice += f", or, if you trust all users of this machine, `chmod o-w {quoted}`"
    raise CannotMaintain(
        f"everybody can write to {what} {str(path)!r}, and may have added valid "
        f"tokens: {advice}"
    )


def check_usable(settings: Settings, engine: Engine, store: BlobStore) -> None:
    """Refuse to start the service if that would hide or destroy existing data.

    Raises CannotMaintain if the database is missing although files exist, a restore was
    interrupted, or the database belongs to a newer version.
    """
    revision = _revision(settings, engine)
    if revision is None and (settings.data / RESTORING).exists():
        raise CannotMaintain(
            f"a restore into {str(settings.data)!r} was interrupted; "
            "run `unghost restore` again"
        )
    if revision is None and any(store.files()):
        raise CannotMaintain(
            f"the database of {str(settings.data)!r} is missing, but its files still "
            "exist; put it back, restore a backup into another folder, or start with "
            "another empty folder"
            if settings.storage == FOLDER
            else f"there are files in {settings.storage}, but the database is new: "
            "garbage collection would delete them; name the database to which they "
            "belong, restore its backup, or choose another prefix in UNGHOST_STORAGE"
        )
    if revision is not None and not is_known(migrations_dir(), revision):
        raise CannotMaintain(newer(revision))


def _revision(settings: Settings, engine: Engine) -> str | None:
    # Not by connecting: that would create a missing SQLite database.
    file = database_file(settings)
    return current_revision(engine) if file is None or file.exists() else None


def keep_private(settings: Settings) -> None:
    """Make the database readable by its owner only, even in a public folder.

    It is created here because SQLite would make it readable for everybody; SQLite gives
    the write-ahead log the mode of the database.
    """
    file = database_file(settings)
    if file is None:
        return
    # An existing file is not opened: closing it would release the POSIX locks of this
    # process's SQLite connections, and other processes could then delete the log.
    with suppress(FileExistsError):
        os.close(os.open(file, os.O_RDWR | os.O_CREAT | os.O_EXCL, _PRIVATE))
    for path in (file, *(file.with_name(file.name + end) for end in ("-wal", "-shm"))):
        with suppress(FileNotFoundError, PermissionError):  # another user owns it
            path.chmod(_PRIVATE)


def check_same_version(settings: Settings, engine: Engine) -> None:
    """Refuse a database that no service of this version has migrated.

    Raises CannotMaintain if it is missing, or its schema has another version.
    """
    revision, head = _revision(settings, engine), head_revision(migrations_dir())
    if revision is None:
        raise CannotMaintain(
            "there is no database of Unghost where the settings say (UNGHOST_DATA, "
            "UNGHOST_DATABASE_URL); start the service first"
        )
    if revision != head:
        raise CannotMaintain(
            f"the database is at schema {revision}, this version needs {head}: run "
            "the service and its workers from the same version"
        )


def newer(revision: str) -> str:
    """The error message for a database with a newer schema."""
    return (
        f"the database is at schema {revision}, this version supports only up to "
        f"{head_revision(migrations_dir())}: a newer Unghost wrote it; install that "
        "one, or restore a backup from before"
    )


@contextmanager
def opened(settings: Settings) -> Iterator[Database]:
    """The database of an existing data folder, at the schema of this version.

    Raises CannotMaintain if it is missing, or its schema has another version.
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
    """The error message for a data folder or server database without tables."""
    if database_file(settings) is None:
        return "the database is empty; start `unghost serve` once, which fills it"
    return (
        f"there is no database in {str(settings.data)!r}; name the data folder with "
        "--data DIR or UNGHOST_DATA"
    )


@contextmanager
def alone(settings: Settings) -> Iterator[None]:
    """Lock the data folder against other backups and garbage collections.

    Raises CannotMaintain if there is no such folder, or another one is running. Where
    the file system has no locks, this only warns: a folder of which no backup can be
    made is worse than a backup that fails because its files were just collected.
    """
    with ExitStack() as held:
        try:
            held.enter_context(durable.locked(settings.data / durable.MAINTENANCE_LOCK))
        except (FileNotFoundError, NotADirectoryError) as exc:
            raise CannotMaintain(
                f"there is no folder {str(settings.data)!r}; name the data folder with "
                "--data DIR or UNGHOST_DATA"
            ) from exc
        except durable.InUse as exc:
            raise CannotMaintain(
                "a backup or a garbage collection is running already in "
                f"{str(settings.data)!r}; try again when it has ended"
            ) from exc
        except durable.CannotLock as exc:
            log.warning(
                "the data folder %r cannot be locked (%s): a backup or a garbage "
                "collection at the same time would not be refused, so start none",
                str(settings.data),
                exc,
            )
        yield


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
    "NoSuchBucket": "there is no such bucket; create it, or correct UNGHOST_STORAGE",
    "NoKeys": "there are no keys for it; set AWS_ACCESS_KEY_ID and "
    "AWS_SECRET_ACCESS_KEY",
    "NotImplemented": "it does not support conditional writes (`If-None-Match: *`)",
    "GenericError": "it does not respond",
    **dict.fromkeys(_ELSEWHERE, "it is in another region; see UNGHOST_STORAGE_REGION"),
    **{reason: _KEYS.format(reason) for reason in _REFUSED},
}


@contextmanager
def stored_files_of(settings: Settings) -> Iterator[BlobStore]:
    """The storage of the files, for a command; opening it changes nothing.

    Raises CannotMaintain if it cannot be used, or does not respond any more.
    """
    with usable_store(settings):
        store = open_store(settings)
        try:
            yield store
        finally:
            store.close()


@contextmanager
def usable_store(settings: Settings) -> Iterator[None]:
    """Raise errors of the storage in the block as `CannotMaintain`, with its name."""
    try:
        yield
    except MissingLibrary as exc:
        raise CannotMaintain(str(exc)) from exc
    except StorageAway as exc:
        raise CannotMaintain(no_store(settings, exc)) from None


def check_moved(settings: Settings, database: Database, store: BlobStore) -> None:
    """Refuse a bucket without any of the files that the database refers to.

    Raises CannotMaintain if UNGHOST_STORAGE was changed, and the files were not moved.
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
            "correct UNGHOST_STORAGE"
        )


def no_store(settings: Settings, away: StorageAway) -> str:
    """The error message for a bucket that cannot be used; it contains no secret."""
    name, _ = bucket_of(settings.storage) or (settings.storage, "")
    return (
        f"the bucket {name!r} at {endpoint_of(settings)} cannot be used: "
        f"{_REASONS.get(away.reason, away.reason)}"
    )


_ROOM: Final = 3
"""A migration needs space for the copy, the log and the changes, each at most as large
as the database."""


def keep_before_migrating(settings: Settings, engine: Engine) -> Path | None:
    """Copy a SQLite database that is about to be migrated; returns the copy, or None.

    A migration is one transaction, so a crash needs no copy. The copy is for going back
    to the former version; it is not made if there is no disk space for it.
    """
    file, revision = database_file(settings), current_revision(engine)
    if file is None or revision in (None, head_revision(migrations_dir())):
        return None
    size = file.stat().st_size
    if shutil.disk_usage(file.parent).free < _ROOM * size + settings.min_free_bytes:
        log.warning("no disk space for a copy of the database at schema %s", revision)
        return None
    copy = file.with_name(f"{file.name}.schema-{revision}")
    draft = copy.with_name(f"{copy.name}.partial")
    draft.unlink(missing_ok=True)
    copy_database(file, draft, lambda _done, _total: None)
    draft.chmod(0o600)
    durable.flush_file(draft)
    draft.replace(copy)
    durable.flush_folder(copy.parent)
    log.warning(
        "a copy of the database at schema %s is kept as %s", revision, copy.name
    )
    return copy
