"""Turns whatever was raised into RFC 9457 problem+json. Knows nothing else."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from typing import Any, Final

from fastapi import FastAPI, Request
from fastapi.encoders import jsonable_encoder
from fastapi.exceptions import RequestValidationError
from sqlalchemy import exc as sql
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response
from starlette.routing import Match

from app import errors
from app.errors import AppError, Fault
from app.logs import current_request_id, error_log
from app.validation_words import in_words
from filter_core.errors import AnnotationErrors, FilterError
from filter_core.values import MAX_FAULTS, escape_text, pointer_token

PROBLEM_TYPE: Final = "application/problem+json"
BUSY_RETRY_S: Final = 2
AWAY_RETRY_S: Final = 5

STATUS: Final[Mapping[type[Exception], HTTPStatus]] = {
    errors.BadRequest: HTTPStatus.BAD_REQUEST,
    errors.MisdirectedHost: HTTPStatus.MISDIRECTED_REQUEST,
    errors.Unauthorised: HTTPStatus.UNAUTHORIZED,
    errors.Forbidden: HTTPStatus.FORBIDDEN,
    errors.NotFound: HTTPStatus.NOT_FOUND,
    errors.Conflict: HTTPStatus.CONFLICT,
    errors.StaleRevision: HTTPStatus.PRECONDITION_FAILED,
    errors.TooLarge: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    errors.TooSlow: HTTPStatus.REQUEST_TIMEOUT,
    errors.UnsupportedMedia: HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
    errors.RangeNotSatisfiable: HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE,
    errors.Unprocessable: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.TooManyRequests: HTTPStatus.TOO_MANY_REQUESTS,
    errors.TryLater: HTTPStatus.SERVICE_UNAVAILABLE,
    errors.DamagedFile: HTTPStatus.INTERNAL_SERVER_ERROR,
    AppError: HTTPStatus.INTERNAL_SERVER_ERROR,
    FilterError: HTTPStatus.UNPROCESSABLE_ENTITY,
}

# What Starlette and FastAPI say by themselves: unknown routes, other methods, bodies.
HTTP_CODES: Final[Mapping[int, str]] = {
    400: "bad_request",
    401: errors.Unauthorised.code,
    403: errors.Forbidden.code,
    404: errors.NotFound.code,
    405: "method_not_allowed",
    413: errors.TooLarge.code,
    415: errors.UnsupportedMedia.code,
    416: errors.RangeNotSatisfiable.code,
    422: errors.Unprocessable.code,
}
_LOCKED: Final = ("locked", "busy", "deadlock", "could not serialize", "lock timeout")
_FULL: Final = ("disk is full", "no space left", "disk full")
_FULL_ERRNO: Final = (errno.ENOSPC, errno.EDQUOT)
_READ_ONLY: Final = ("readonly database", "read-only transaction")
_NO_DESCRIPTOR_ERRNO: Final = (errno.EMFILE, errno.ENFILE)
_READ_ONLY_ERRNO: Final = (errno.EROFS, errno.EACCES, errno.EPERM)
_NUL: Final = ("cannot contain nul",)
_DAMAGED: Final = ("malformed", "not a database", "invalid page")


@dataclass(frozen=True)
class Problem:
    """One error as it goes over the wire; `more` faults are counted, not listed."""

    status: int
    code: str
    detail: str
    faults: tuple[Fault, ...] = ()
    more: int = 0
    headers: Mapping[str, str] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def document(self, *, instance: str, request_id: str) -> dict[str, Any]:
        """The problem itself; `instance` is the path that was asked for."""
        extra = {"more_errors": self.more} if self.more else {}
        return {
            "type": "about:blank",
            "title": HTTPStatus(self.status).phrase,
            "status": self.status,
            # What is repeated of a request may have halves of surrogate pairs.
            "detail": escape_text(self.detail),
            "instance": instance,
            "code": self.code,
            "request_id": request_id,
            "errors": [
                {name: escape_text(said) for name, said in vars(fault).items()}
                for fault in self.faults
            ],
            **extra,
            **jsonable_encoder(self.extra),
        }

    def response(self, *, instance: str, request_id: str) -> JSONResponse:
        """The problem as an answer."""
        return JSONResponse(
            self.document(instance=instance, request_id=request_id),
            self.status,
            headers=dict(self.headers),
            media_type=PROBLEM_TYPE,
        )


def install(app: FastAPI) -> None:
    """Have the app answer with problems where Starlette would answer with text.

    Everything that is not named here travels on to `middleware.Problems`.
    """
    app.add_exception_handler(HTTPException, _answer)
    app.add_exception_handler(RequestValidationError, _answer)


async def _answer(request: Request, exc: Exception) -> Response:
    problem = problem_of(exc)
    path = request.url.path
    if problem.status == HTTPStatus.METHOD_NOT_ALLOWED:
        allowed = ", ".join(_methods_at(request))
        detail = f"{request.method} is not possible here, but {allowed}"
        problem = replace(problem, detail=detail, headers={"Allow": allowed})
    elif problem.detail == HTTPStatus.NOT_FOUND.phrase:
        problem = replace(problem, detail=f"there is nothing at {path!r}")
    return problem.response(instance=path, request_id=current_request_id.get())


def _methods_at(request: Request) -> Iterator[str]:
    # Starlette names the methods of the first route that fits the path only.
    for method in ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"):
        scope: dict[str, Any] = {"type": "http", "method": method, "headers": []}
        scope |= {"path": request.url.path, "root_path": "", "app": request.app}
        routes = request.app.router.routes
        if any(route.matches(dict(scope))[0] is Match.FULL for route in routes):
            yield method


def problem_of(exc: Exception) -> Problem:
    """The problem for any exception; what nobody foresaw is logged and is a 500."""
    if isinstance(exc, RequestValidationError):
        return _invalid_request(exc)
    if isinstance(exc, HTTPException):
        return _http_problem(exc)
    if isinstance(exc, ClientDisconnect):  # nobody is left to read this
        return Problem(400, "client_disconnected", "the body ended too early")
    known = _translated(exc)
    if isinstance(known, AppError):
        return _app_problem(known)
    if isinstance(known, FilterError):
        return _filter_problem(known)
    error_log.error("unexpected error", exc_info=exc)
    return Problem(
        500, "internal", "the service failed; the request id finds it in its log"
    )


def _translated(exc: Exception) -> Exception:
    """Failures of the database and the disk, in the service's own words."""
    number = exc.errno if isinstance(exc, OSError) else None
    if number in _FULL_ERRNO or _says(exc, _FULL):
        error_log.error("no room left", exc_info=exc)
        return errors.StorageFull(
            "there is no room left to store this", retry_after_s=AWAY_RETRY_S
        )
    if number in _NO_DESCRIPTOR_ERRNO:
        error_log.error("too many files are open", exc_info=exc)
        return errors.NotReady(
            "too many files and connections are open; try again",
            retry_after_s=AWAY_RETRY_S,
        )
    if number in _READ_ONLY_ERRNO or _says(exc, _READ_ONLY):
        error_log.error("the data folder is read-only", exc_info=exc)
        return errors.StorageReadOnly(
            "nothing can be stored: the data folder is read-only",
            retry_after_s=AWAY_RETRY_S,
        )
    return _translated_sql(exc)


def _translated_sql(exc: Exception) -> Exception:
    if _says(exc, _DAMAGED):
        error_log.error("the database is damaged", exc_info=exc)
        return errors.DatabaseDamaged(
            "the database is damaged; `unghost doctor` on the server says more",
            retry_after_s=AWAY_RETRY_S,
        )
    if isinstance(exc, sql.TimeoutError) or _says(exc, _LOCKED):
        return errors.DatabaseBusy(
            "the service is busy writing; try again", retry_after_s=BUSY_RETRY_S
        )
    if isinstance(exc, (sql.OperationalError, sql.InterfaceError)):
        error_log.error("the database failed", exc_info=exc)
        return errors.NotReady(
            "the database does not answer; try again", retry_after_s=AWAY_RETRY_S
        )
    if isinstance(exc, sql.DataError) and _says(exc, _NUL):
        # PostgreSQL holds no such text, so nothing can be called so.
        return errors.NotFound("name with", "\0")
    if isinstance(exc, sql.IntegrityError):
        error_log.warning("lost a race", exc_info=exc)
        return errors.Conflict("someone changed the same thing meanwhile; look again")
    return exc


def _says(exc: Exception, phrases: tuple[str, ...]) -> bool:
    if not isinstance(exc, sql.DatabaseError):
        return False
    text = str(exc.orig).lower()
    return any(phrase in text for phrase in phrases)


def _app_problem(exc: AppError) -> Problem:
    status = next(STATUS[cls] for cls in type(exc).__mro__ if cls in STATUS)
    headers, extra = dict(_headers_of(exc)), dict(_more_of(exc))
    return Problem(
        int(status), exc.kind, exc.detail, exc.faults, headers=headers, extra=extra
    )


def _more_of(exc: AppError) -> Iterator[tuple[str, Any]]:
    if isinstance(exc, errors.StaleRevision):
        yield "current", exc.current
    if isinstance(exc, errors.CountChanged):
        yield "found", exc.found


def _headers_of(exc: AppError) -> Iterator[tuple[str, str]]:
    if isinstance(exc, errors.Unauthorised):
        yield "WWW-Authenticate", 'Bearer realm="unghost"'
    if isinstance(exc, errors.TryLater):
        yield "Retry-After", str(exc.retry_after_s)
    if isinstance(exc, errors.RangeNotSatisfiable):
        yield "Content-Range", f"bytes */{exc.size_bytes}"
    if isinstance(exc, (errors.TooLarge, errors.TooSlow)):
        # What the client still sends is not wanted.
        yield "Connection", "close"


def _filter_problem(exc: FilterError) -> Problem:
    if not isinstance(exc, AnnotationErrors):
        fault = Fault(exc.pointer, exc.kind, exc.detail)
        return Problem(422, exc.kind, exc.detail, (fault,))
    faults = tuple(Fault(one.pointer, one.kind, one.detail) for one in exc.errors)
    return Problem(422, exc.kind, exc.detail, faults, exc.more_errors)


def _http_problem(exc: HTTPException) -> Problem:
    if isinstance(exc.__cause__, AppError):  # FastAPI wraps what reading a body raises
        return _app_problem(exc.__cause__)
    code = HTTP_CODES.get(exc.status_code, "http_error")
    return Problem(exc.status_code, code, str(exc.detail), headers=exc.headers or {})


def _invalid_request(exc: RequestValidationError) -> Problem:
    errors = exc.errors()
    faults = tuple(_fault_of(error) for error in errors[:MAX_FAULTS])
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    at = faults[0].pointer if errors[0]["loc"][0] == "body" else ""
    detail = f"{at}{': ' if at else ''}{faults[0].detail}{more}"
    return Problem(422, "invalid_request", detail, faults, len(errors) - len(faults))


def _fault_of(error: Mapping[str, Any]) -> Fault:
    # Never the input itself: it may be a token.
    where, *path = error["loc"]
    detail = in_words(error)
    if error["type"] == "missing" and not path:
        detail = "expected a body of JSON, found none"
    if where != "body":
        detail = f"{where} parameter {path[0]!r}: {detail}"
        path = [where, *path]
    return Fault(_json_pointer(path), error["type"], detail)


def _json_pointer(path: list[str | int]) -> str:
    return "".join(f"/{pointer_token(step)}" for step in path)
