"""The router of every route: nobody can forget who may call it, or what it takes.

Before a body is read: authorisation, unknown query parameters, the media type. Around
the work: Idempotency-Key. The rest of a route is its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Coroutine, Iterator
from datetime import timedelta
from typing import Any, Final

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Request, params
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from pydantic import BaseModel
from starlette.convertors import Convertor, register_url_convertor
from starlette.responses import Response

from app.deps import BEARER, COOKIE, authorise, settings_of, write_session
from app.errors import UnknownParameter, UnsupportedMedia
from app.middleware import BODY_ALLOWANCE
from app.security import SAFE_METHODS, Role
from app.services.idempotency import (
    AlreadyAnswered,
    RepeatableRequest,
    checked_key,
    request_digest,
    store_answer,
)

Handler = Callable[[Request], Coroutine[Any, Any, Response]]


class _AnyText(Convertor[str]):
    """``:any`` in a path: slashes and line ends too, so that words can be had on both.

    Starlette's own ``:path`` matches no line end: such a key would be a 404.
    """

    regex = r"[\s\S]*"

    def convert(self, value: str) -> str:
        """As it is."""
        return value

    def to_string(self, value: str) -> str:
        """As it is."""
        return value


register_url_convertor("any", _AnyText())

LARGE_BODY: Final = {"x-large-body": True}
"""``openapi_extra`` of a route that streams its body: up to ``max_batch_bytes``."""


MAX_OPEN_BYTES: Final = 4096
"""A body from somebody without a token: a token, and little else."""


class OpenRoute(APIRoute):
    """A route that anybody may call; still no unknown parameters or media types."""

    def allow(self, request: Request) -> None:
        """How large and how slow the body of nobody in particular may be."""
        allowance = request.scope[BODY_ALLOWANCE]
        allowance.max_bytes = min(allowance.max_bytes, MAX_OPEN_BYTES)
        allowance.until = time.monotonic() + settings_of(request).body_wait_s

    def get_route_handler(self) -> Handler:
        """The endpoint behind the checks that all routes share."""
        endpoint = super().get_route_handler()
        known = frozenset(_query_names(self.dependant))
        body = self.body_field
        takes_json = body is not None and not isinstance(body.field_info, params.Form)

        async def checked(request: Request) -> Response:
            _refuse_unknown_parameters(request, known)
            if takes_json:
                self.allow(request)
                _expect_json(request)
            return await endpoint(request)

        return checked


class ApiRoute(OpenRoute):
    """A route for those whose role allows it; a POST that writes may be repeated."""

    reading_needs = Role.VIEWER
    writing_needs = Role.REVIEWER

    def allow(self, request: Request) -> None:
        """A JSON body is held in memory: it has a smaller limit than a stream."""
        allowance = request.scope[BODY_ALLOWANCE]
        limit = int(settings_of(request).max_json_bytes)
        allowance.max_bytes = min(allowance.max_bytes, limit)

    def get_route_handler(self) -> Handler:
        """The endpoint behind authorisation and idempotency."""
        endpoint = super().get_route_handler()
        large = LARGE_BODY.items() <= (self.openapi_extra or {}).items()
        repeatable = is_repeatable(self) and not large

        async def authorised(request: Request) -> Response:
            reads = request.method in SAFE_METHODS
            await authorise(
                request, self.reading_needs if reads else self.writing_needs
            )
            if large:
                allowance = request.scope[BODY_ALLOWANCE]
                allowance.max_bytes = settings_of(request).max_batch_bytes
            if request.method == "POST" and "idempotency-key" in request.headers:
                checked_key(request.headers["idempotency-key"])
                if repeatable:
                    return await _answer_once(endpoint, request)
            return await endpoint(request)

        return authorised


class ApiRouter(APIRouter):
    """A router whose routes all ask for a token.

    `read` and `write` are the roles that its safe and its other methods need.
    """

    def __init__(
        self,
        *,
        prefix: str = "",
        tag: str = "",
        read: Role = Role.VIEWER,
        write: Role = Role.REVIEWER,
    ) -> None:
        class Guarded(ApiRoute):
            reading_needs = read
            writing_needs = write

        super().__init__(
            prefix=prefix,
            tags=[tag] if tag else None,
            route_class=Guarded,
            dependencies=[BEARER, COOKIE],
            redirect_slashes=False,
        )


class OpenRouter(APIRouter):
    """A router for the few routes that anybody may call."""

    def __init__(self, *, prefix: str = "", tag: str = "") -> None:
        super().__init__(
            prefix=prefix,
            tags=[tag] if tag else None,
            route_class=OpenRoute,
            redirect_slashes=False,
        )


def is_repeatable(route: APIRoute) -> bool:
    """True for a POST that writes: its Idempotency-Key is honoured."""
    return "POST" in (route.methods or ()) and _uses(route.dependant, write_session)


async def repeat_answer(_request: Request, exc: Exception) -> Response:
    """What a repeated POST gets: the answer that the first one got."""
    if not isinstance(exc, AlreadyAnswered):
        raise exc
    answer = exc.answer
    headers = {**answer.headers, "Idempotent-Replayed": "true"}
    if answer.media_type:
        headers["Content-Type"] = answer.media_type
    return Response(answer.body, answer.status, headers)


async def _answer_once(endpoint: Handler, request: Request) -> Response:
    """Call the endpoint with the key's claim prepared, and keep what it answers."""
    url = request.url
    digest = request_digest(
        request.method.encode(),
        f"{url.path}?{url.query}".encode(),
        request.headers.get("content-type", "").encode(),
        await request.body(),
    )
    repeatable = RepeatableRequest(
        request.state.principal.token_id,
        checked_key(request.headers["idempotency-key"]),
        digest,
        timedelta(hours=settings_of(request).idempotency_hours),
    )
    request.state.repeatable = repeatable
    response = await endpoint(request)

    def store() -> None:
        store_answer(
            request.state.write_session,
            repeatable,
            status=response.status_code,
            headers=response.headers,
            body=getattr(response, "body", None),
        )

    # A thread of its own: the shared ones may all be waiting for this transaction.
    await to_thread.run_sync(store, limiter=CapacityLimiter(1))
    return response


def _refuse_unknown_parameters(request: Request, known: frozenset[str]) -> None:
    unknown = sorted(set(request.query_params) - known)
    if unknown:
        expected = ", ".join(sorted(known)) or "none"
        raise UnknownParameter(
            f"unknown query parameter {unknown[0]!r}; known here: {expected}"
        )


def _expect_json(request: Request) -> None:
    media_type = request.headers.get("content-type", "").partition(";")[0].strip()
    if _has_body(request) and media_type.lower() != "application/json":
        raise UnsupportedMedia(
            f"the body must be application/json, it says {media_type or 'nothing'!r}"
        )


def _query_names(dependant: Dependant) -> Iterator[str]:
    for field in dependant.query_params:
        model = field.field_info.annotation
        if isinstance(model, type) and issubclass(model, BaseModel):
            yield from (one.alias or name for name, one in model.model_fields.items())
        else:
            yield field.alias
    for sub in dependant.dependencies:
        yield from _query_names(sub)


def _uses(dependant: Dependant, call: Callable[..., Any]) -> bool:
    return any(sub.call is call or _uses(sub, call) for sub in dependant.dependencies)


def _has_body(request: Request) -> bool:
    length = request.headers.get("content-length", "0")
    return length != "0" or "transfer-encoding" in request.headers
