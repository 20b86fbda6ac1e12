"""The store of the files as a start and commands open it: usable, or said why not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from app.db.engine import Database
from app.errors import StorageAway
from app.repositories.stored_files import StoredFileRepository
from app.services.data_folder import CannotMaintain
from app.settings import Settings
from app.storage import BLOBS, BlobStore, MissingLibrary, endpoint_of, open_store
from app.storage_url import FOLDER, bucket_of

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
