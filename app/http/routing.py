"""The router of all routes: what it checks of a request before it calls the endpoint.

Before a body is read, it checks the caller's role, the size of the body, the query
parameters and the media type. Once the body is there, the request waits until its
token has a free place; routes for large bodies (`body_up_to`) do both themselves.
A POST with an Idempotency-Key is passed on to `app.http.transaction`, where the
transaction of a route that writes is described.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Coroutine, Iterator
from functools import cached_property, partial
from typing import ClassVar, Final

from anyio import fail_after
from fastapi import APIRouter, Request, params
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from pydantic import BaseModel
from starlette.convertors import Convertor, register_url_convertor
from starlette.responses import Response, StreamingResponse
from starlette.routing import Match
from starlette.types import Receive, Scope, Send

from app.errors import BadRequest, DatabaseBusy, UnknownParameter, UnsupportedMedia
from app.http.admission import TokenPlaces
from app.http.bodies import StrictRequest
from app.http.deps import (
    BEARER,
    ROLE_OF,
    admission_of,
    authorise,
    services_of,
    settings_of,
)
from app.http.idempotency import checked_key
from app.http.middleware import BODY_ALLOWANCE, MAX_UNASKED_BYTES, BodyAllowance
from app.http.transaction import WRITE_WAIT_S, respond_once, write_session
from app.incoming import HeldBytes, OpenBodies
from app.security import SAFE_METHODS
from unghost.wire.words import Role

_NO_BODY: Final = "unghost.no_body"
"""Key of the ASGI scope: true if the request is a HEAD that is handled as a GET."""

Handler = Callable[[Request], Coroutine[object, object, Response]]


class HeadRoute(APIRoute):
    """A route whose GET handles HEAD as well.

    A HEAD needs the same role and takes the same parameters as the GET. It neither
    starts a streamed body nor opens files.
    """

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Match a HEAD as if it were a GET."""
        return super().matches(self._as_get(scope))

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a HEAD as a GET; the server leaves out the body of its response."""
        await super().handle(self._as_get(scope), receive, send)

    def get_route_handler(self) -> Handler:
        """The endpoint; a HEAD gets the status and headers of its response."""
        endpoint = super().get_route_handler()

        async def respond(request: Request) -> Response:
            response = await endpoint(request)
            if not asks_for_head(request):
                return response
            request.scope["method"] = "HEAD"  # so that FileResponse reads no file
            if not isinstance(response, StreamingResponse):
                return response
            bare = Response(None, response.status_code, background=response.background)
            bare.raw_headers = response.raw_headers
            return bare

        return respond

    def _as_get(self, scope: Scope) -> Scope:
        if scope["type"] != "http" or scope["method"] != "HEAD":
            return scope
        if "GET" not in (self.methods or ()):
            return scope
        return {**scope, "method": "GET", _NO_BODY: True}


def asks_for_head(request: Request) -> bool:
    """Whether the request is a HEAD that is handled as a GET."""
    return bool(request.scope.get(_NO_BODY, False))


class _AnyText(Convertor[str]):
    """``:any`` in a path: any text, with slashes and line breaks.

    Starlette's own ``:path`` matches no line break: a key with one would give 404
    instead of an error that explains what is wrong with it.
    """

    regex = r"[\s\S]*"

    def convert(self, value: str) -> str:
        return value

    def to_string(self, value: str) -> str:
        return value


register_url_convertor("any", _AnyText())

BODY_LIMIT: Final = "x-body-limit"
"""In ``openapi_extra`` of a route: the setting with the maximum size of its body."""


def body_up_to(setting: str) -> dict[str, str]:
    """``openapi_extra`` of a route that reads its body itself, up to this setting."""
    return {BODY_LIMIT: setting}


BODY_STREAMED: Final = "x-body-streamed"
"""In ``openapi_extra`` of a route: true if its body is processed while it arrives."""


def streamed_up_to(setting: str) -> dict[str, str | bool]:
    """``openapi_extra`` of a route that processes its body while it arrives.

    The body is never held as a whole, so an Idempotency-Key is not supported.
    """
    return {**body_up_to(setting), BODY_STREAMED: True}


LARGE_BODY: Final = streamed_up_to("max_batch_bytes")
"""``openapi_extra`` of a route that takes batches of frames."""

CLIENT_LEFT: Final = 499
"""A status for the log only: the client has closed the connection."""


class OpenRoute(HeadRoute):
    """Refuses unknown parameters and media types, as all routes do.

    Used as it is, a route without authentication.
    """

    @property
    def takes_json(self) -> bool:
        """Whether the body is JSON that is validated by a schema."""
        body = self.body_field
        return body is not None and not isinstance(body.field_info, params.Form)

    @property
    def body_setting(self) -> str | None:
        """The setting that limits the body; None: `MAX_UNASKED_BYTES` limits it."""
        default = "max_json_bytes" if self.takes_json else None
        named: str | None = (self.openapi_extra or {}).get(BODY_LIMIT, default)
        return named

    @cached_property
    def writes(self) -> bool:
        """Whether the endpoint has a transaction that writes."""
        return write_session in _calls(self.dependant)

    async def check_before_body(self, request: Request) -> None:
        """Limit the size and time of the body, for a caller that is not identified."""
        allowance: BodyAllowance = request.scope[BODY_ALLOWANCE]
        allowance.limit_to(min(self.max_body_bytes(request), MAX_UNASKED_BYTES))
        allowance.until = time.monotonic() + settings_of(request).body_wait_s

    def max_body_bytes(self, request: Request) -> int:
        """The maximum size of the body."""
        name = self.body_setting
        if name is None:
            return MAX_UNASKED_BYTES
        return int(getattr(settings_of(request), name))

    async def respond(self, endpoint: Handler, request: Request) -> Response:
        return await endpoint(request)

    def get_route_handler(self) -> Handler:
        """The endpoint, preceded by the checks that all routes share."""
        endpoint = super().get_route_handler()
        names = frozenset(_query_names(self.dependant))
        takes_json = self.takes_json

        async def checked(request: Request) -> Response:
            await self.check_before_body(request)
            _check_parameters(request, names)
            if takes_json:
                _expect_json(request)
            strict = StrictRequest(request.scope, request.receive)
            return await self.respond(endpoint, strict)

        return checked


class ApiRoute(OpenRoute):
    """A route that needs a role; a POST that writes may have an Idempotency-Key."""

    @cached_property
    def role(self) -> Role:
        """The least role that a caller needs: the one in the endpoint's signature.

        Raises TypeError: it names none, or several; the service does not start then.
        """
        roles = {ROLE_OF[call] for call in _calls(self.dependant) if call in ROLE_OF}
        if len(roles) != 1:
            raise TypeError(
                f"expected one role in the signature of {self.name}, found "
                f"{', '.join(sorted(roles)) or 'none'}"
            )
        return roles.pop()

    def get_route_handler(self) -> Handler:
        """The endpoint, whose description gets its role."""
        needed = f"Needs the role {self.role}."
        if needed not in self.description:
            self.description += f"\n\n{needed}"
        return super().get_route_handler()

    async def check_before_body(self, request: Request) -> None:
        """Check the role of the caller, and limit the body.

        Its size is limited, and for JSON also the time until it has arrived. Other
        bodies may be so large that they take hours.
        """
        await authorise(request, self.role)
        allowance: BodyAllowance = request.scope[BODY_ALLOWANCE]
        allowance.limit_to(self.max_body_bytes(request))
        if self.takes_json:
            allowance.until = time.monotonic() + settings_of(request).body_wait_s
        held = HeldBytes(services_of(request).one(OpenBodies))
        is_streamed = bool((self.openapi_extra or {}).get(BODY_STREAMED))
        allowance.count_in(held, is_streamed=is_streamed)

    async def respond(self, endpoint: Handler, request: Request) -> Response:
        """Call the endpoint; a repeated request gets the response of the first one."""
        if request.method == "POST" and "idempotency-key" in request.headers:
            key = checked_key(request.headers["idempotency-key"])
            if self.writes:
                endpoint = partial(respond_once, endpoint, key=key)
        if BODY_LIMIT in (self.openapi_extra or {}) and not self.writes:
            return await endpoint(request)  # it limits how many large bodies it reads
        if request.method not in SAFE_METHODS:
            await request.body()  # before taking a place: it may arrive slowly
        admission = admission_of(request)
        places = admission.writing if self.writes else admission.reading
        wait_s = WRITE_WAIT_S if self.writes else None
        return await _call_in_turn(endpoint, request, places, wait_s)


async def _call_in_turn(
    endpoint: Handler, request: Request, places: TokenPlaces, wait_s: float | None
) -> Response:
    """Call the endpoint when its caller's token has a free place.

    Until then the request waits without a thread, so that no token uses all threads, or
    delays the writes of all others. If the client disconnects meanwhile, the endpoint
    is not called. Raises DatabaseBusy: there was no free place within `wait_s` seconds;
    None waits without end.
    """
    own = places.of(request.state.principal.token_id)
    has_to_wait = own.available_tokens < 1
    try:
        with fail_after(wait_s):
            await own.acquire_on_behalf_of(request)
    except TimeoutError as exc:
        raise DatabaseBusy("too many writes of this token are waiting") from exc
    try:
        if has_to_wait and await request.is_disconnected():
            return Response(status_code=CLIENT_LEFT)
        return await endpoint(request)
    finally:
        own.release_on_behalf_of(request)


async def has_left(request: Request) -> None:
    """Return once the client has disconnected; call it after the body was read."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


class OpenRouter(APIRouter):
    """A router for the few routes without authentication."""

    kind: ClassVar[type[OpenRoute]] = OpenRoute

    def __init__(self, *, prefix: str = "", tag: str = "") -> None:
        super().__init__(
            prefix=prefix,
            tags=[tag] if tag else None,
            route_class=self.kind,
            dependencies=[BEARER] if self.kind is ApiRoute else None,
            redirect_slashes=False,
        )


class ApiRouter(OpenRouter):
    """A router whose routes all require a token, of the role in their signature."""

    kind = ApiRoute


def _check_parameters(request: Request, names: frozenset[str]) -> None:
    """Refuse a query parameter that is unknown or given twice: it would be ignored."""
    unknown = sorted(set(request.query_params) - names)
    if unknown:
        expected = ", ".join(sorted(names)) or "none"
        raise UnknownParameter(
            f"unknown query parameter {unknown[0]!r}; known here: {expected}"
        )
    for name in names & set(request.query_params):
        count = len(request.query_params.getlist(name))
        if count > 1:
            raise BadRequest(
                f"query parameter {name!r}: expected once, found {count} values",
                code="repeated_parameter",
            )


def _expect_json(request: Request) -> None:
    media_type = request.headers.get("content-type", "").partition(";")[0].strip()
    length = request.headers.get("content-length", "0")
    has_body = length != "0" or "transfer-encoding" in request.headers
    if has_body and media_type.lower() != "application/json":
        raise UnsupportedMedia(
            f"expected application/json, found {media_type or 'no media type'!r}"
        )


def _query_names(dependant: Dependant) -> Iterator[str]:
    for field in dependant.query_params:
        model = field.field_info.annotation
        if isinstance(model, type) and issubclass(model, BaseModel):
            yield from (
                parameter.alias or name
                for name, parameter in model.model_fields.items()
            )
        else:
            yield field.alias
    for sub in dependant.dependencies:
        yield from _query_names(sub)


def _calls(dependant: Dependant) -> Iterator[object]:
    """The functions on which an endpoint depends, also indirectly."""
    for sub in dependant.dependencies:
        yield sub.call
        yield from _calls(sub)
