"""Turns exceptions into problem documents (RFC 9457, application/problem+json)."""

from __future__ import annotations

import errno
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from http import HTTPStatus
from typing import Final, TypedDict, get_args

from fastapi import FastAPI, Request
from fastapi.encoders import jsonable_encoder
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel
from sqlalchemy import exc as sql
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response
from starlette.routing import Match

from app import errors
from app.errors import AppError
from app.logs import current_request_id, error_log
from app.memory import forget_tracebacks
from filter_core.errors import FilterError, NotAvailable, problem_of
from filter_core.values import pointer_token, similar
from unghost.wire.frames import CROPS_PATTERN
from unghost.wire.model import MAX_FAULTS, Fault, Problem

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

# Codes for errors that Starlette and FastAPI raise themselves, such as unknown routes.
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
_Failure = tuple[tuple[int, ...], tuple[str, ...], str, Callable[..., AppError]]
_FAILURES: Final[tuple[_Failure, ...]] = (
    (
        (errno.ENOSPC, errno.EDQUOT),
        ("disk is full", "no space left", "disk full"),
        "no disk space left",
        partial(errors.StorageFull, "there is no disk space left to store this"),
    ),
    (
        (errno.EMFILE, errno.ENFILE),
        (),
        "too many files are open",
        partial(errors.NotReady, "too many files and connections are open; try again"),
    ),
    (
        (errno.EROFS, errno.EACCES, errno.EPERM),
        ("readonly database", "read-only transaction"),
        "the data folder is read-only",
        partial(
            errors.StorageReadOnly,
            "nothing can be stored: the data folder is read-only",
        ),
    ),
    (
        (),
        ("malformed", "not a database", "invalid page"),
        "the database is damaged",
        partial(
            errors.DatabaseDamaged,
            "the database is damaged; `unghost doctor` on the server says more",
        ),
    ),
)
"""Failures of the disk and the database: numbers of an OSError, phrases of the
database's errors, the line of the log, and the error that clients get."""


@dataclass(frozen=True)
class Refusal:
    """An error response, without its request id.

    `extensions` are fields of the `Problem` that only some errors have.
    """

    status: int
    code: str
    detail: str
    faults: tuple[Fault, ...] = ()
    headers: Mapping[str, str] = field(default_factory=dict)
    extensions: Mapping[str, object] = field(default_factory=dict)

    def problem(self, *, instance: str, request_id: str) -> Problem:
        """The problem document of one request; `instance` is the path of its URL."""
        return Problem(
            type="about:blank",
            title=HTTPStatus(self.status).phrase,
            status=self.status,
            detail=self.detail,
            instance=instance,
            code=self.code,
            request_id=request_id,
            errors=self.faults,
            **self.extensions,
        )

    def response(self, *, instance: str, request_id: str) -> JSONResponse:
        """The response with the problem document."""
        problem = self.problem(instance=instance, request_id=request_id)
        return JSONResponse(
            problem.model_dump(mode="json"),
            self.status,
            headers=dict(self.headers),
            media_type=PROBLEM_TYPE,
        )


def install(app: FastAPI) -> None:
    """Make the app send problem documents for errors that Starlette sends as text.

    `middleware.Problems` handles all other exceptions.
    """
    app.add_exception_handler(HTTPException, _respond)
    app.add_exception_handler(RequestValidationError, _respond)


async def _respond(request: Request, exc: Exception) -> Response:
    body = getattr(request.scope.get("route"), "body_field", None)
    if isinstance(exc, RequestValidationError) and body is not None:
        refusal = _invalid_request(exc, body.field_info.annotation)
    else:
        refusal = refusal_of(exc)
    forget_tracebacks(exc)
    path = request.url.path
    if refusal.status == HTTPStatus.METHOD_NOT_ALLOWED:
        allowed = ", ".join(_methods_at(request))
        detail = f"{request.method} is not allowed here; allowed: {allowed}"
        refusal = replace(refusal, detail=detail, headers={"Allow": allowed})
    elif refusal.detail == HTTPStatus.NOT_FOUND.phrase:
        refusal = replace(refusal, detail=f"there is nothing at {path!r}")
    return refusal.response(instance=path, request_id=current_request_id.get())


def _methods_at(request: Request) -> Iterator[str]:
    # Starlette would name only the methods of the first route with this path.
    for method in ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"):
        scope: dict[str, object] = {"type": "http", "method": method, "headers": []}
        scope |= {"path": request.url.path, "root_path": "", "app": request.app}
        routes = request.app.router.routes
        if any(route.matches(dict(scope))[0] is Match.FULL for route in routes):
            yield method


def refusal_of(exc: Exception) -> Refusal:
    """The error response for an exception; unexpected ones are logged and give 500."""
    if isinstance(exc, RequestValidationError):
        return _invalid_request(exc)
    if isinstance(exc, HTTPException):
        if isinstance(exc.__cause__, AppError):  # raised while FastAPI read the body
            return _refusal_by_app(exc.__cause__)
        code = HTTP_CODES.get(exc.status_code, "http_error")
        headers = exc.headers or {}
        return Refusal(exc.status_code, code, str(exc.detail), headers=headers)
    if isinstance(exc, ClientDisconnect):  # the response cannot be delivered
        return Refusal(400, "client_disconnected", "the body ended too early")
    translated = _translated(exc)
    if isinstance(translated, AppError):
        return _refusal_by_app(translated)
    if isinstance(translated, FilterError):
        problem = problem_of(translated)
        faults = tuple(Fault(**fault) for fault in problem["errors"])
        more = _more_errors(problem.get("more_errors", 0))
        # If something is not available, it says which package to install.
        is_absent = isinstance(translated, NotAvailable)
        where = " on the machine of the server" if is_absent else ""
        detail = f"{problem['detail']}{where}"
        return Refusal(422, problem["code"], detail, faults, extensions=more)
    error_log.error("unexpected error", exc_info=exc)
    return Refusal(500, "internal", "the service failed; its log names the request id")


def _translated(exc: Exception) -> Exception:
    """Failures of the database and the disk as errors of the service (`AppError`)."""
    number = exc.errno if isinstance(exc, OSError) else None
    text = str(exc.orig).lower() if isinstance(exc, sql.DatabaseError) else ""
    for numbers, phrases, event, error in _FAILURES:
        if number in numbers or any(phrase in text for phrase in phrases):
            error_log.error(event, exc_info=exc)
            return error(retry_after_s=AWAY_RETRY_S)
    is_locked = any(phrase in text for phrase in _LOCKED)
    if isinstance(exc, sql.TimeoutError) or is_locked:
        return errors.DatabaseBusy(
            "the service is busy writing; try again", retry_after_s=BUSY_RETRY_S
        )
    return _translated_sql(exc, text)


def _translated_sql(exc: Exception, text: str) -> Exception:
    if isinstance(exc, (sql.OperationalError, sql.InterfaceError)):
        error_log.error("the database failed", exc_info=exc)
        return errors.NotReady(
            "the database does not respond; try again", retry_after_s=AWAY_RETRY_S
        )
    if isinstance(exc, sql.DataError) and "cannot contain nul" in text:
        # PostgreSQL cannot store NUL in a text, so there is nothing of this name.
        return errors.NotFound("name with", "\0")
    if isinstance(exc, sql.IntegrityError):
        error_log.warning("another request has changed the same rows", exc_info=exc)
        return errors.Conflict("another request changed the same data; read it again")
    return exc


def _refusal_by_app(exc: AppError) -> Refusal:
    status = next(STATUS[cls] for cls in type(exc).__mro__ if cls in STATUS)
    headers: dict[str, str] = {}
    extensions: dict[str, object] = {}
    if isinstance(exc, errors.StaleRevision):
        extensions["current"] = jsonable_encoder(exc.current)
    if isinstance(exc, errors.CountChanged):
        extensions["found"] = exc.found
    if isinstance(exc, errors.Unauthorised):
        headers["WWW-Authenticate"] = 'Bearer realm="unghost"'
    if isinstance(exc, errors.TryLater):
        headers["Retry-After"] = str(exc.retry_after_s)
    if isinstance(exc, errors.RangeNotSatisfiable):
        headers["Content-Range"] = f"bytes */{exc.size_bytes}"
    if isinstance(exc, (errors.TooLarge, errors.TooSlow)):
        headers["Connection"] = "close"  # the rest of the body is not read
    return Refusal(int(status), exc.kind, exc.detail, exc.faults, headers, extensions)


def _more_errors(more: int) -> dict[str, int]:
    return {"more_errors": more} if more else {}


def _invalid_request(exc: RequestValidationError, body: object = None) -> Refusal:
    """`body`: the annotation of the route's body, by which unknown keys are told."""
    errors = exc.errors()
    faults = tuple(_fault_of(error, body) for error in errors[:MAX_FAULTS])
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    at = faults[0].pointer if errors[0]["loc"][0] == "body" else ""
    detail = f"{at}{': ' if at else ''}{faults[0].detail}{more}"
    unlisted = _more_errors(len(errors) - len(faults))
    return Refusal(422, "invalid_request", detail, faults, extensions=unlisted)


class _Context(TypedDict, total=False):
    ctx: dict[str, object]


class InvalidValue(_Context):
    """One of pydantic's errors; `ctx` holds the bounds that were violated."""

    type: str
    loc: tuple[int | str, ...]
    msg: str
    input: object


def _fault_of(error: InvalidValue, body: object) -> Fault:
    # Never the input itself: it may be a token.
    where, *path = error["loc"]
    detail = in_words(error)
    if error["type"] == "extra_forbidden" and path:
        meant = similar(path[-1], _keys_at(body, path[:-1]))
        detail = f"unknown name; did you mean {meant!r}?" if meant else detail
    if error["type"] == "missing" and not path:
        detail = "expected a body of JSON, found none"
    if where != "body":
        detail = f"{where} parameter {path[0]!r}: {detail}"
        path = [where, *path]
    pointer = "".join(f"/{pointer_token(step)}" for step in path)
    return Fault(pointer=pointer, code=error["type"], detail=detail)


def _keys_at(body: object, path: Sequence[int | str]) -> set[str]:
    """The keys of the objects at a place in a body, by its annotation."""
    models = list(_models_in(body))
    for step in path:
        if isinstance(step, str):
            fields = [pair for model in models for pair in model.model_fields.items()]
            models = [
                inner
                for name, field in fields
                if step in (name, field.alias)
                for inner in _models_in(field.annotation)
            ]
    return {
        field.alias or name
        for model in models
        for name, field in model.model_fields.items()
    }


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_in(inner)


_KINDS: Final[tuple[tuple[type | tuple[type, ...], str], ...]] = (
    (bool, "true or false"),
    ((int, float), "a number"),
    (str, "a text"),
    (Mapping, "an object"),
    ((list, tuple), "a list"),
    (type(None), "null"),
)
_WITHOUT_VALUE: Final[Mapping[str, str]] = {
    "missing": "required, but missing",
    "extra_forbidden": "unknown name; it may be misspelt",
}
_EXPECTED: Final[Mapping[str, str]] = {
    "model_attributes_type": "an object",
    "model_type": "an object",
    "dict_type": "an object",
    "string_type": "a text",
    "list_type": "a list",
    "tuple_type": "a list",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_parsing_size": "a smaller whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "timezone_aware": "a time with its zone, such as 2026-01-31T12:00:00Z",
    "datetime_type": "a time such as 2026-01-31T12:00:00Z",
    "datetime_parsing": "a time such as 2026-01-31T12:00:00Z",
    "datetime_from_date_parsing": "a time such as 2026-01-31T12:00:00Z",
    "byte_size": "a size such as 64MiB",
    "literal_error": "{expected}",
    "enum": "{expected}",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "string_too_short": "at least {min_length} characters",
    "string_too_long": "at most {max_length} characters",
    "too_short": "at least {min_length} items",
    "too_long": "at most {max_length} items, found {actual_length}",
}
_PATTERNS: Final[Mapping[str, str]] = {
    r"^[A-Za-z0-9](?:[A-Za-z0-9._-]{0,98}[A-Za-z0-9])?$": "1 to 100 of "
    "a-z, A-Z, 0-9, dot, dash and underscore, with a letter or a digit at both ends",
    r"^[0-9a-f]{64}$": "a digest of 64 hexadecimal digits",
    r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]*[^\s\x00-\x1f\x7f-\x9f]$": "printable "
    "characters, and no space at the end",
    r"^[^\x00-\x1f\x7f]+$": "characters that can be printed",
    r"^[^\x00]*$": "characters other than NUL",
    r"^((kept|rejected|unmeasured)(,(kept|rejected|unmeasured))*)?$": "kept, rejected "
    "and unmeasured, separated by commas",
    r"^[0-9]+$": "digits",
    r"^((0|1|[01]?\.[0-9]{1,9})(,(0|1|[01]?\.[0-9]{1,9})){0,2})?$": "up to three "
    "shares from 0 to 1, separated by commas",
    r"^[a-z0-9-]{1,40}$": "1 to 40 of a-z, 0-9 and dash",
    CROPS_PATTERN: "up to 32 of ID-PAD-HEIGHT, such as 7-0.25-256, separated by commas",
}
_WORD: Final = re.compile(r"(?!u[gscd]_)[\w.-]{1,40}")
"""What may be quoted where one of a few words is expected: no secret of ours."""
_NUMBER: Final = re.compile(r"[+-]?\d{1,20}(\.\d{1,20})?")


def in_words(error: InvalidValue, *, show: bool = False) -> str:
    """One of pydantic's errors as text: what was expected, and what was found.

    `show`: whether a found text may be quoted; in a request it may be a token.
    """
    kind, context = str(error["type"]), error.get("ctx") or {}
    if kind in _WITHOUT_VALUE:
        return _WITHOUT_VALUE[kind]
    if kind == "value_error":
        return str(error["msg"]).removeprefix("Value error, ")
    is_pattern = kind == "string_pattern_mismatch"
    words = _EXPECTED.get(kind)
    if is_pattern:
        words = _PATTERNS.get(str(context.get("pattern")))
    if words is None:
        return str(error["msg"])
    expected = words.format_map(context)
    # For a text, the expectation is enough: "found a text" would add nothing.
    is_text = isinstance(error.get("input"), str)
    if (is_pattern and is_text and not show) or "found" in expected:
        return f"expected {expected}"
    if kind in ("literal_error", "enum") and is_text:
        show = show or _WORD.fullmatch(str(error["input"])) is not None
        if not show:
            return f"expected {expected}"
    return f"expected {expected}, found {_found(error.get('input'), show)}"


def _found(value: object, show: bool) -> str:
    """A value in an error message: numbers are quoted, others named by their kind."""
    if isinstance(value, str) and (show or _NUMBER.fullmatch(value)):
        return repr(value[:60]) if show else value
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return f"{value:.15g}" if isinstance(value, float) else str(value)[:40]
    names = (name for of, name in _KINDS if isinstance(value, of))
    if isinstance(value, str) and not value:
        return "an empty text"
    return next(names, "something else")
