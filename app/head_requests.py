"""HEAD on every route that answers GET: the same, without a body (RFC 9110, 9.3.2)."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any, Final

from fastapi import Request
from fastapi.routing import APIRoute
from starlette.responses import Response, StreamingResponse
from starlette.routing import Match
from starlette.types import Receive, Scope, Send

_NO_BODY: Final = "unghost.no_body"
"""Key of the ASGI scope: true if a HEAD is answered as a GET."""

Handler = Callable[[Request], Coroutine[Any, Any, Response]]


class HeadRoute(APIRoute):
    """A route whose GET answers HEAD as well.

    Whatever a GET asks of its caller and of its parameters, a HEAD does. What makes a
    body piece by piece is not begun, and files are not opened.
    """

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """A HEAD is found where a GET is."""
        return super().matches(self._as_get(scope))

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer; the server leaves the body of an answer to HEAD out."""
        await super().handle(self._as_get(scope), receive, send)

    def get_route_handler(self) -> Handler:
        """The endpoint, of whose answer a HEAD gets the beginning."""
        endpoint = super().get_route_handler()

        async def answer(request: Request) -> Response:
            response = await endpoint(request)
            if not asks_for_head(request):
                return response
            request.scope["method"] = "HEAD"  # a file is looked at, and not read
            if isinstance(response, StreamingResponse):
                return without_body(response)
            return response

        return answer

    def _as_get(self, scope: Scope) -> Scope:
        if scope["type"] != "http" or scope["method"] != "HEAD":
            return scope
        if "GET" not in (self.methods or ()):
            return scope
        return {**scope, "method": "GET", _NO_BODY: True}


def asks_for_head(request: Request) -> bool:
    """Whether the answer's body is of no use, although the method seems to be GET."""
    return bool(request.scope.get(_NO_BODY, False))


def without_body(response: Response) -> Response:
    """Status and headers of an answer that was not begun; no length if it had none."""
    bare = Response(status_code=response.status_code, background=response.background)
    bare.raw_headers = response.raw_headers
    return bare


def without_length(response: Response) -> Response:
    """An answer to HEAD whose body was not made, so that nobody knows its length."""
    del response.headers["content-length"]
    return response
