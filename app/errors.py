"""The errors of the service, as one tree; `http.problems` maps them to HTTP responses.

AppError                     the base of all of them, below `filter_core.UnghostError`
|-- BadRequest               the request itself is malformed
|   |-- BadCursor            a cursor that no page of the list can have given
|   |-- UnknownParameter     a query parameter that the route does not have
|   `-- MisdirectedHost      the Host header has a name that is not served here
|-- Unauthorised             no credentials, or none that are valid
|-- Forbidden                valid credentials without the right to do this
|-- NotFound                 no such thing
|   |-- NoSuchDataset        no dataset has this name
|   |-- NoSuchClass          the dataset exists, but has no class of this name
|   `-- NoSuchFile           the frame exists, but was stored without this file
|-- Conflict                 in conflict with the current state or stored content
|   |-- FrameConflict        another frame is stored under this key
|   `-- CountChanged         a list has more or fewer boxes than were expected
|-- StaleRevision            something has changed since the client read it:
|   |-- StaleReview          ... a box under review
|   |-- StaleConfig          ... the configuration that is or becomes the active one
|   `-- StaleSnapshot        ... the boxes that a filter selects
|-- TooLarge                 larger than a limit of the settings
|-- TooSlow                  the body stopped arriving
|-- UnsupportedMedia         a media type that the route does not accept
|-- RangeNotSatisfiable      a byte range outside the file
|-- Unprocessable            well-formed, but the content cannot be used
|   `-- IdempotencyKeyReuse  the key was used for another request
|-- DamagedFile              a stored file is missing or has changed
`-- TryLater                 the same request may succeed later
    |-- TooManyRequests      a quota is used up
    |-- DatabaseBusy         the database was locked or overloaded for too long
    |-- StorageFull          no disk space for the uploaded data
    |-- StorageReadOnly      the data folder cannot be written
    |-- StorageAway          the storage of the files does not respond
    |-- DatabaseDamaged      the database file is damaged
    `-- NotReady             the service cannot work yet, or is stopping

Messages name the thing, what was expected and what was found; never a path of the
server, SQL or a secret.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from filter_core.errors import UnghostError

if TYPE_CHECKING:  # children that read pixels raise these, and need no pydantic
    from unghost.wire.model import Fault


class AppError(UnghostError):
    """Base of all errors that the service reports to a client.

    `faults` lists each mistake where a request has several.
    """

    def __init__(
        self, detail: str, *, code: str = "", faults: Sequence[Fault] = ()
    ) -> None:
        super().__init__(detail, code=code)
        self.faults = tuple(faults)


class BadRequest(AppError):
    """The request itself is malformed."""

    code = "bad_request"


class BadCursor(BadRequest):
    """A cursor that no page of the list can have given."""

    code = "bad_cursor"

    def __init__(self, cursor: str) -> None:
        super().__init__(f"cursor {cursor[:80]!r} is not a cursor of this list")


class UnknownParameter(BadRequest):
    """A query parameter that the route does not have."""

    code = "unknown_parameter"


class MisdirectedHost(BadRequest):
    """The Host header has a name that is not served here."""

    code = "misdirected_host"


class Unauthorised(AppError):
    """No credentials, or none that are valid."""

    code = "unauthorised"


class Forbidden(AppError):
    """Valid credentials without the right to do this."""

    code = "forbidden"


class NotFound(AppError):
    """No such thing: ``NotFound("dataset", "town10")``."""

    code = "not_found"

    def __init__(self, kind: str, key: object) -> None:
        super().__init__(f"there is no {kind} {key!r}")


class NoSuchDataset(NotFound):
    """There is no dataset of this name; `meant` is the nearest of the others."""

    def __init__(self, name: str, meant: str | None) -> None:
        hint = f"; did you mean {meant!r}?" if meant else ""
        AppError.__init__(self, f"there is no dataset {name!r}{hint}")


class NoSuchClass(NotFound):
    """The dataset has no class of this name; `meant` is the nearest of its names."""

    def __init__(self, dataset: str, name: str, meant: str | None) -> None:
        hint = f"; did you mean {meant!r}?" if meant else ""
        AppError.__init__(self, f"dataset {dataset!r} has no class {name!r}{hint}")


class NoSuchFile(NotFound):
    """The frame was stored without this file."""

    def __init__(self, kind: str, frame_id: int) -> None:
        AppError.__init__(self, f"frame {frame_id} has no file {kind!r}")


class Conflict(AppError):
    """The request is in conflict with the current state or stored content."""

    code = "conflict"


class FrameConflict(Conflict):
    """Another frame is stored under this key."""

    code = "frame_conflict"


class CountChanged(Conflict):
    """A list has more or fewer boxes than the client expected."""

    code = "count_changed"

    def __init__(self, what: str, *, found: int, expected: int) -> None:
        super().__init__(f"{what} {found} boxes, expected {expected}")
        self.found = found


class StaleRevision(AppError):
    """Something has changed since the client read it; `current` is its state now."""

    code = "stale_revision"

    def __init__(self, detail: str, *, current: Mapping[str, object] | None) -> None:
        super().__init__(detail)
        self.current = current


class StaleReview(StaleRevision):
    """The box was answered since the person saw it; `current` is its decision now."""

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


class StaleConfig(StaleRevision):
    """Another configuration is or becomes the active one; `current` is that version."""

    code = "stale_config"


class StaleSnapshot(StaleRevision):
    """A filter selects other boxes than the client saw, or some of them have changed.

    `current` has the `total` and the `snapshot` of the filter's list now.
    """

    code = "stale_snapshot"

    def __init__(
        self, *, expected: int, found: int, changed: int, current: Mapping[str, object]
    ) -> None:
        super().__init__(
            f"the filter selects {found} boxes now, {expected} when they were listed; "
            f"added, decided again or answered since then: {changed}",
            current=current,
        )


class TooLarge(AppError):
    """Larger than a limit of the settings."""

    code = "too_large"


class TooSlow(AppError):
    """The body stopped arriving, or took too long; it may be sent again."""

    code = "request_timeout"


class UnsupportedMedia(AppError):
    """A media type that the route does not accept."""

    code = "unsupported_media_type"


class RangeNotSatisfiable(AppError):
    """A byte range outside the file."""

    code = "range_not_satisfiable"

    def __init__(self, *, size_bytes: int) -> None:
        super().__init__(f"the range is outside the file's {size_bytes} bytes")
        self.size_bytes = size_bytes


class Unprocessable(AppError):
    """The request is well-formed, but its content cannot be used."""

    code = "unprocessable"


class IdempotencyKeyReuse(Unprocessable):
    """The Idempotency-Key was used for another request."""

    code = "idempotency_key_reuse"


class DamagedFile(AppError):
    """A stored file is missing or has changed; the client cannot fix that."""

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
    """The database was locked or overloaded for too long."""

    code = "database_busy"


class StorageFull(TryLater):
    """No disk space for the uploaded data."""

    code = "storage_full"


class StorageReadOnly(TryLater):
    """The data folder, or the disk that it is on, cannot be written."""

    code = "storage_read_only"


class StorageAway(TryLater):
    """The storage of the files does not respond, or with an error of its own.

    `reason` is for the service's operator: one word, such as an error code of S3.
    """

    code = "storage_away"

    def __init__(self, reason: str) -> None:
        super().__init__(
            "the storage of the files does not respond; try again", retry_after_s=5
        )
        self.reason = reason


class DatabaseDamaged(TryLater):
    """The database file is damaged and has to be restored from a backup."""

    code = "database_damaged"


class NotReady(TryLater):
    """The service cannot work yet, or is stopping."""

    code = "not_ready"
