"""What the service refuses, as one tree. Knows no HTTP; `http.problems` translates.

AppError                     anything that the service says no to
|-- BadRequest               the request itself is malformed
|   |-- BadCursor            a cursor that no page of the list can have given
|   |-- UnknownParameter     a query parameter that the route does not have
|   `-- MisdirectedHost      asked under a host name that is not served here
|-- Unauthorised             no credentials, or none that are valid
|-- Forbidden                valid credentials, but not for this
|-- NotFound                 no such thing
|   `-- NoSuchFile           the frame is there, but came without this file
|-- Conflict                 the state, or other content, is in the way
|   |-- FrameConflict        another frame is stored under this key
|   `-- CountChanged         a list has more or fewer boxes than were expected
|-- StaleRevision            someone changed the thing since it was looked at
|   |-- StaleReview          ... the thing is a box under review
|   `-- StaleSnapshot        ... the thing is all that a filter selects
|-- TooLarge                 larger than a limit of the settings
|-- TooSlow                  a body that stopped arriving
|-- UnsupportedMedia         a media type that is not read here
|-- RangeNotSatisfiable      a byte range outside the file
|-- Unprocessable            understood, but the content cannot be used
|   `-- IdempotencyKeyReuse  the key was used for another request
|-- DamagedFile              a stored file is gone, or not what was stored
`-- TryLater                 the same request may succeed later
    |-- TooManyRequests      a quota is used up
    |-- DatabaseBusy         the database did not take the work in time
    |-- StorageFull          no room for what was sent
    |-- StorageReadOnly      the data folder does not take anything
    |-- StorageAway          the store of the files does not answer
    |-- DatabaseDamaged      the database cannot be read any more
    `-- NotReady             the service is not (or no longer) able to work

Messages name the thing, what was expected and what was found; never a path of the
server, SQL or a secret.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:  # children that read pixels raise these, and need no pydantic
    from unghost.wire.model import Fault


class AppError(Exception):
    """Base of everything the service refuses.

    `code` is stable and for programs, the text is for people; `faults` lists the
    single mistakes where there are several.
    """

    code: ClassVar[str] = "internal"

    def __init__(
        self, detail: str, *, code: str = "", faults: Sequence[Fault] = ()
    ) -> None:
        super().__init__(detail)
        self.detail = detail
        self.kind = code or type(self).code
        self.faults = tuple(faults)


class BadRequest(AppError):
    """The request itself is malformed."""

    code = "bad_request"


class BadCursor(BadRequest):
    """A cursor that no page of the list can have given."""

    code = "bad_cursor"

    def __init__(self, cursor: str) -> None:
        super().__init__(f"cursor {cursor[:80]!r} is not one of ours")


class UnknownParameter(BadRequest):
    """A query parameter that the route does not have."""

    code = "unknown_parameter"


class MisdirectedHost(BadRequest):
    """Asked under a host name that is not served here."""

    code = "misdirected_host"


class Unauthorised(AppError):
    """No credentials, or none that are valid."""

    code = "unauthorised"


class Forbidden(AppError):
    """Valid credentials, but not for this."""

    code = "forbidden"


class NotFound(AppError):
    """No such thing: ``NotFound("dataset", "town10")``."""

    code = "not_found"

    def __init__(self, kind: str, key: object) -> None:
        super().__init__(f"there is no {kind} {key!r}")


class NoSuchFile(NotFound):
    """A frame came without this file."""

    def __init__(self, kind: str, frame_id: int) -> None:
        AppError.__init__(self, f"frame {frame_id} has no file {kind!r}")


class Conflict(AppError):
    """The state, or other content, is in the way."""

    code = "conflict"


class FrameConflict(Conflict):
    """Another frame is stored under this key."""

    code = "frame_conflict"


class CountChanged(Conflict):
    """More or fewer boxes are listed than the client expected."""

    code = "count_changed"

    def __init__(self, what: str, *, found: int, expected: int) -> None:
        super().__init__(f"{what} {found} boxes, you expected {expected}")
        self.found = found


class StaleRevision(AppError):
    """Someone changed the thing since it was looked at; `current` is how it is now."""

    code = "stale_revision"

    def __init__(self, detail: str, *, current: Mapping[str, object] | None) -> None:
        super().__init__(detail)
        self.current = current


class StaleReview(StaleRevision):
    """A box was reviewed by someone else since; `current` is its decision now."""

    code = "stale_review"

    def __init__(
        self,
        *,
        box_id: int,
        seen: int,
        found: int,
        current: Mapping[str, object] | None = None,
    ) -> None:
        super().__init__(
            f"box {box_id} is at revision {found}, you reviewed revision {seen}",
            current=current,
        )


class StaleSnapshot(StaleRevision):
    """A filter selects other boxes than were seen, or some of them have changed.

    `current` is what a list of the filter says now: `total` and `snapshot`.
    """

    code = "stale_snapshot"

    def __init__(
        self, *, expected: int, found: int, changed: int, current: Mapping[str, object]
    ) -> None:
        super().__init__(
            f"the filter selects {found} boxes, {expected} when you looked; {changed} "
            "of them came, were decided anew or were answered since",
            current=current,
        )


class TooLarge(AppError):
    """Larger than a limit of the settings."""

    code = "too_large"


class TooSlow(AppError):
    """A body that stopped arriving, or took too long; it may be sent again."""

    code = "request_timeout"


class UnsupportedMedia(AppError):
    """A media type that is not read here."""

    code = "unsupported_media_type"


class RangeNotSatisfiable(AppError):
    """A byte range outside the file."""

    code = "range_not_satisfiable"

    def __init__(self, *, size_bytes: int) -> None:
        super().__init__(f"the range is outside the file's {size_bytes} bytes")
        self.size_bytes = size_bytes


class Unprocessable(AppError):
    """Understood, but the content cannot be used."""

    code = "unprocessable"


class IdempotencyKeyReuse(Unprocessable):
    """The Idempotency-Key was used for another request."""

    code = "idempotency_key_reuse"


class DamagedFile(AppError):
    """A stored file is gone, or not what was stored; nobody who asks can mend that."""

    code = "damaged_file"

    def __init__(self, digest: str, what: str) -> None:
        super().__init__(
            f"the stored file {digest} {what}; `unghost doctor --verify` on the "
            "server lists all such files and says what to do"
        )


class TryLater(AppError):
    """The same request may succeed after `retry_after_s` seconds."""

    code = "try_later"

    def __init__(
        self,
        detail: str,
        *,
        retry_after_s: int = 1,
        code: str = "",
        faults: Sequence[Fault] = (),
    ) -> None:
        super().__init__(detail, code=code, faults=faults)
        self.retry_after_s = retry_after_s


class TooManyRequests(TryLater):
    """A quota is used up."""

    code = "too_many_requests"


class DatabaseBusy(TryLater):
    """The database did not take the work in time."""

    code = "database_busy"


class StorageFull(TryLater):
    """No room for what was sent."""

    code = "storage_full"


class StorageReadOnly(TryLater):
    """The data folder, or the disk that it is on, does not take anything."""

    code = "storage_read_only"


class StorageAway(TryLater):
    """The store of the files does not answer, or not as it should.

    `reason` is for the service's operator: a word, as S3 calls it.
    """

    code = "storage_away"

    def __init__(self, reason: str) -> None:
        super().__init__(
            "the store of the files does not answer; try again", retry_after_s=5
        )
        self.reason = reason


class DatabaseDamaged(TryLater):
    """The database cannot be read any more, until somebody has restored it."""

    code = "database_damaged"


class NotReady(TryLater):
    """The service is not, or no longer, able to work."""

    code = "not_ready"


def forget_frames(error: BaseException) -> None:
    """Drop the traceback of an error that was answered, and of those that led to it.

    The frames in a traceback hold what was sent, and often the error itself: such a
    circle stays in memory until the collector looks for circles, which is seldom.
    """
    left: list[BaseException | None] = [error]
    while left:
        one = left.pop()
        if one is not None and one.__traceback__ is not None:
            one.__traceback__ = None
            left += [one.__cause__, one.__context__]
