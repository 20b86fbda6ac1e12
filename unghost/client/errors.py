"""The exceptions that calls raise, as one tree.

ApiError                the server's response is not a success
|-- BadRequest          400: a malformed request or an unknown parameter
|-- Unauthorized        401: no token, or an unknown one
|-- Forbidden           403: the token's role does not allow it
|-- NotFound            404
|-- Conflict            409: other content under the same name, or the wrong state
|   `-- StaleReview     412: someone else changed it first; `current` is its state
|-- TooLarge            413
|-- Invalid             422 and 415: `errors` lists the faults
|-- Unavailable         408, 429, 502, 503, 504: try again later
|   `-- NoResponse      no response at all: refused, cut, or too late
|-- ServerFault         500
`-- UnexpectedAnswer    a response that is not Unghost's
RunFailed               the run or export that was waited for failed or was cancelled
DamagedDownload         the downloaded bytes do not have the expected digest
InvalidName             a name or a key that no address can contain; nothing was sent
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timezone
from email.utils import parsedate_to_datetime
from typing import TYPE_CHECKING

import httpx

from unghost import wire

if TYPE_CHECKING:
    from unghost.wire.model import Json


class ApiError(Exception):
    """The server's response is not a success.

    `code` is stable and for programs, `detail` is for people. `errors` lists the single
    errors, at most a hundred; `more_errors` is the number of further ones. `request_id`
    identifies the request in the log of the server. `retry_after_s` is the time to wait
    before a retry, if the server named one.
    """

    def __init__(
        self, status: int, problem: Json, retry_after_s: float | None = None
    ) -> None:
        self.status = status
        self.problem = dict(problem)
        self.code = str(problem.get("code") or "unknown")
        self.detail = str(problem.get("detail") or problem.get("title") or status)
        self.request_id = problem.get("request_id")
        self.retry_after_s = retry_after_s
        errors = problem.get("errors")
        self.errors = tuple(
            wire.Fault.read(fault)
            for fault in (errors if isinstance(errors, list) else ())
            if isinstance(fault, Mapping)
        )
        more = problem.get("more_errors")
        self.more_errors = more if isinstance(more, int) else 0
        super().__init__(self.detail)

    def extend(self, text: str) -> None:
        """Add to the message what the caller knows about the failed operation."""
        self.detail = f"{self.detail}; {text}"
        self.args = (self.detail,)


class BadRequest(ApiError):
    """400: a malformed request or an unknown parameter."""


class Unauthorized(ApiError):
    """401: no token, or an unknown one."""


class Forbidden(ApiError):
    """403: the token's role does not allow it."""


class NotFound(ApiError):
    """404: the object does not exist."""


class Conflict(ApiError):
    """409: other content under the same name, or the wrong state."""


class StaleReview(Conflict):
    """412: someone else was first; `current` is the present state.

    For a box, this is its decision; for a selection of boxes, `total` and `snapshot`;
    for a configuration, the version.
    """

    @property
    def current(self) -> Json | None:
        """The present state on the server; None if the response did not contain it."""
        current = self.problem.get("current")
        return current if isinstance(current, Mapping) else None


class TooLarge(ApiError):
    """413: more bytes than the server accepts."""


class Invalid(ApiError):
    """422 or 415: the content cannot be used; `errors` lists the faults."""


class Unavailable(ApiError):
    """408, 429, 502, 503 or 504: the server cannot respond now."""


class NoResponse(Unavailable):
    """There is no response, or only a part of one; `status` is 0.

    `address` is the server's, without a user and a password. `sent`: a connection was
    open, so that the server may have executed the request.
    """

    def __init__(self, address: str, why: str, *, sent: bool) -> None:
        detail = f"no response from {address}: {why}"
        super().__init__(0, {"code": "no_response", "detail": detail})
        self.address = address
        self.sent = sent


class ServerFault(ApiError):
    """500: the server failed; its log has the request id."""


class UnexpectedAnswer(ApiError):
    """A response that is not Unghost's: from another server, or a proxy's own page."""


class RunFailed(Exception):
    """A run or an export that was waited for failed or was cancelled."""


class DamagedDownload(Exception):
    """The downloaded bytes do not have the digest that the server announced."""


class InvalidName(ValueError):
    """A name or a key that no address can contain, such as ``..``; nothing was sent."""


_BY_STATUS: dict[int, type[ApiError]] = {
    400: BadRequest,
    401: Unauthorized,
    403: Forbidden,
    404: NotFound,
    408: Unavailable,
    409: Conflict,
    412: StaleReview,
    413: TooLarge,
    415: Invalid,
    422: Invalid,
    429: Unavailable,
    500: ServerFault,
    502: Unavailable,
    503: Unavailable,
    504: Unavailable,
}


def error_of(response: httpx.Response) -> ApiError:
    """The exception for a response that is no success, whose body has been read."""
    problem = json_object(response)
    kind = _BY_STATUS.get(response.status_code, ApiError)
    wait_s = retry_after_s(response.headers.get("Retry-After"))
    if problem is not None and "code" in problem:
        return kind(response.status_code, problem, wait_s)
    # A body that is no problem document is from another program, such as a proxy.
    if kind is not Unavailable:
        kind = UnexpectedAnswer
    detail = f"{response.url.copy_with(query=None)} answered {response.status_code}"
    return kind(
        response.status_code,
        {"code": "unexpected_answer", "detail": f"{detail} without a reason"},
        wait_s,
    )


def error_of_problem(problem: Json) -> ApiError:
    """The exception for a problem document in a response, such as a batch's line."""
    status = problem.get("status")
    status = status if isinstance(status, int) else 500
    return _BY_STATUS.get(status, ApiError)(status, problem)


def unexpected(response: httpx.Response, why: str) -> UnexpectedAnswer:
    """The exception for a 2xx response with unexpected content."""
    where = response.url.copy_with(query=None)
    problem = {"code": "unexpected_answer", "detail": f"the response of {where} {why}"}
    return UnexpectedAnswer(response.status_code, problem)


def run_failed(what: str, state: str, error: wire.Failure | None) -> RunFailed:
    """The exception for a run or an export that failed or was cancelled."""
    why = "" if error is None else f": {error.detail or error.code}"
    return RunFailed(f"{what} is {state}{why}")


def json_object(response: httpx.Response) -> Json | None:
    """The body as a JSON object, or None if it is anything else."""
    try:
        body = response.json()
    except ValueError:
        return None
    return body if isinstance(body, dict) else None


def retry_after_s(header: str | None, now: datetime | None = None) -> float | None:
    """Seconds of a `Retry-After` header: a number or an HTTP date; else None."""
    if header is None:
        return None
    if header.strip().isdigit():
        return float(header)
    try:
        when = parsedate_to_datetime(header)
    except ValueError:
        return None
    if when.tzinfo is None:
        when = when.replace(tzinfo=timezone.utc)
    return max(0.0, (when - (now or datetime.now(timezone.utc))).total_seconds())
