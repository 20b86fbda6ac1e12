"""Middleware for all requests, as plain ASGI, so that streams are not buffered.

From the outside in: RequestId, AccessLog, SecurityHeaders, Compression, Problems,
NoNewWork, KnownHosts, BodyLimit. Errors of the last three become problem documents,
too.
"""

from __future__ import annotations

import asyncio
import gzip
import math
import re
import time
import uuid
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from anyio import fail_after, to_thread
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.engine.chunk import Stop
from app.errors import BadRequest, MisdirectedHost, TooLarge, TooSlow
from app.http.bodies import stopping
from app.http.problems import refusal_of
from app.incoming import HeldBytes
from app.logs import (
    AccessRecord,
    current_request_id,
    error_log,
    log_access,
    logged_with,
)
from app.memory import forget_tracebacks
from app.metrics import RequestMetrics
from app.security import SAFE_METHODS, host_name
from app.settings import ANY_HOST, bracketed


class HttpMiddleware(ABC):
    """Middleware that handles HTTP requests, and passes on all else: start and stop."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Called by the server for each request, and once for start and stop."""
        if scope["type"] == "http":
            await self.handle(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    @abstractmethod
    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""


class NoNewWork(HttpMiddleware):
    """Refuses writing requests while the service is stopping; reading ones are served.

    A request that is cut off when the time to stop is over gets the same response.
    """

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        stop: Stop = scope["app"].state.services.engine.stopping
        if stop.is_set() and scope["method"] not in SAFE_METHODS:
            raise stopping()
        try:
            await self._app(scope, receive, send)
        except asyncio.CancelledError:
            if not stop.is_set():
                raise
            raise stopping() from None


BODY_ALLOWANCE: Final = "unghost.body_allowance"
"""Key of the ASGI scope: a `BodyAllowance`, whose limit each route sets."""
MAX_UNASKED_BYTES: Final = 4096
"""Largest body if no route has set a limit, or the caller is not identified yet."""

SECURITY_HEADERS: Final[Mapping[str, str]] = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Frame-Options": "DENY",
    "Cache-Control": "private, no-cache",
}
_REQUEST_ID: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


class RequestId(HttpMiddleware):
    """Gives each request an id: that of its header if well-formed, else a new one."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        request_id = Headers(scope=scope).get("x-request-id", "")
        if not _REQUEST_ID.fullmatch(request_id):
            request_id = uuid.uuid4().hex

        async def send_with_id(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)["X-Request-ID"] = request_id
            await send(message)

        with logged_with(request_id):
            await self._app(scope, receive, send_with_id)


class AccessLog(HttpMiddleware):
    """Logs a line for each request, and counts it for the metrics.

    The line has method, path, status, time and caller; no query string and no header.
    """

    def __init__(self, app: ASGIApp, metrics: RequestMetrics) -> None:
        super().__init__(app)
        self._metrics = metrics

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        started = time.perf_counter()
        status = 0

        async def send_and_note(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, send_and_note)
        finally:
            seconds = time.perf_counter() - started
            method, path = scope["method"], scope["path"]
            route = getattr(scope.get("route"), "path", None)
            self._metrics.observe(method, route, status, seconds)
            principal = scope.get("state", {}).get("principal")
            who = principal.name if principal else None
            client = (scope.get("client") or (None,))[0]
            log_access(AccessRecord(method, path, route, status, seconds, who, client))


class SecurityHeaders(HttpMiddleware):
    """Adds security headers to every response, except where a route has set its own."""

    def __init__(self, app: ASGIApp, content_security_policy: str) -> None:
        super().__init__(app)
        headers = {
            **SECURITY_HEADERS,
            "Content-Security-Policy": content_security_policy,
        }
        self._headers = [
            (name.lower().encode(), value.encode()) for name, value in headers.items()
        ]

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = list(message.get("headers", ()))
                own = {name for name, _ in headers}
                headers += [header for header in self._headers if header[0] not in own]
                message["headers"] = headers
            await send(message)

        await self._app(scope, receive, send_with_headers)


class Compression(HttpMiddleware):
    """Compresses whole texts, such as JSON, for clients that take gzip; no streams."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        accepted = Headers(scope=scope).get("accept-encoding", "").lower()
        if not _GZIP.search(accepted):
            await self._app(scope, receive, send)
            return
        start: Message | None = None

        async def send_compressed(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start":
                headers = Headers(raw=message["headers"])
                kind = headers.get("content-type", "").partition(";")[0]
                if kind in _COMPRESSED and "content-encoding" not in headers:
                    start = message
                else:
                    await send(message)
                return
            if start is not None:
                begun, start = start, None
                body = message.get("body", b"")
                if not message.get("more_body") and len(body) >= _LEAST_BYTES:
                    headers = MutableHeaders(scope=begun)
                    body = await _compressed(body, headers["content-type"])
                    headers["Content-Encoding"] = "gzip"
                    headers["Content-Length"] = str(len(body))
                    if etag := headers.get("etag"):  # another representation
                        headers["ETag"] = f"W/{etag.removeprefix('W/')}"
                    message = {**message, "body": body}
                MutableHeaders(scope=begun).add_vary_header("Accept-Encoding")
                await send(begun)
            await send(message)

        await self._app(scope, receive, send_compressed)


_COMPRESSED: Final = frozenset(
    {"application/json", "image/svg+xml", "text/css", "text/html", "text/javascript"}
)
_GZIP: Final = re.compile(r"\bgzip\b(?!\s*;\s*q=0(\.0*)?\s*(,|$))")
_LEAST_BYTES: Final = 1400
"""What is shorter fits into one packet anyway."""
_AT_ONCE: Final = 100_000
"""Bytes that are compressed within a few ms, and so in the event loop."""


async def _compressed(body: bytes, media_type: str) -> bytes:
    if not media_type.startswith("application/json"):
        return _compressed_file(body)
    if len(body) <= _AT_ONCE:
        return gzip.compress(body, compresslevel=1, mtime=0)
    return await to_thread.run_sync(gzip.compress, body, 1)


@lru_cache(maxsize=128)
def _compressed_file(body: bytes) -> bytes:
    """A file of the page, compressed once."""
    return gzip.compress(body, mtime=0)


class Problems(HttpMiddleware):
    """Turns every exception into a problem document."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        started = False

        async def send_and_note(message: Message) -> None:
            nonlocal started
            started = started or message["type"] == "http.response.start"
            await send(message)

        try:
            await self._app(scope, receive, send_and_note)
        except Exception as exc:
            if started:
                # Part of the response was sent: closing the connection is the only way
                # to signal the failure.
                error_log.error("failed while sending a response", exc_info=exc)
                raise
            response = refusal_of(exc).response(
                instance=scope["path"], request_id=current_request_id.get()
            )
            forget_tracebacks(exc)
            await response(scope, receive, send)


PROBES: Final = frozenset({"/healthz", "/readyz"})
"""Paths that are served under any host name: they tell only whether it runs."""


class KnownHosts(HttpMiddleware):
    """Refuses requests with unknown host names (against DNS rebinding).

    The address at which a connection has arrived is known as well: a name that is
    rebound to it is still another Host.
    """

    def __init__(self, app: ASGIApp, hosts: frozenset[str]) -> None:
        super().__init__(app)
        self._hosts = hosts

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        names = Headers(scope=scope).getlist("host")
        if len(names) != 1 and scope["http_version"] == "1.1":
            raise BadRequest(
                f"expected one Host, found {len(names)}", code="malformed_http"
            )
        # Without the zone of a link-local address; IPv4 on a socket for IPv6 is mapped.
        address = scope["server"][0].partition("%")[0].removeprefix("::ffff:")
        hosts = {*self._hosts, bracketed(address)}
        is_known = bool(names) and hosts.issuperset(map(host_name, names))
        if not (is_known or ANY_HOST in self._hosts or scope["path"] in PROBES):
            raise MisdirectedHost(
                "this service is not known under that host name; "
                "UNGHOST_ALLOWED_HOSTS adds names"
            )
        await self._app(scope, receive, send)


@dataclass
class BodyAllowance:
    """The limits on size and time of one request's body.

    `announced` is the Content-Length; `until` is a time of `time.monotonic`. `held`
    counts the bytes in memory once the caller is identified; a route that streams its
    body counts the bytes it keeps by itself.
    """

    announced: int
    max_bytes: int = MAX_UNASKED_BYTES
    until: float = math.inf
    held: HeldBytes | None = None
    is_streamed: bool = False

    def count_in(self, held: HeldBytes, *, is_streamed: bool) -> None:
        """Count the whole announced body as held, unless it is streamed.

        Raises NotReady: the limit on the memory for bodies is reached.
        """
        self.held, self.is_streamed = held, is_streamed
        self.hold(0)

    def hold(self, received: int) -> None:
        """Update the count: `received` bytes of the body have arrived."""
        if self.held is not None and not self.is_streamed:
            self.held.hold(max(received, self.announced))

    def release(self) -> None:
        """Release the body's bytes when the request has ended."""
        if self.held is not None:
            self.held.hold(0)

    def limit_to(self, max_bytes: int) -> None:
        """Set the maximum size; raises TooLarge if a larger one is announced."""
        self.max_bytes = max_bytes
        self.check(self.announced)

    def check(self, size: int) -> None:
        """Raise TooLarge if a body of this size is not allowed."""
        if size > self.max_bytes:
            raise TooLarge(f"the body is larger than {self.max_bytes} bytes")


class BodyLimit(HttpMiddleware):
    """Refuses a body that is larger than allowed, regardless of its Content-Length.

    Until a route has set its limit, `MAX_UNASKED_BYTES` are allowed. A body that stops
    arriving is refused too: it would keep its connection open forever.
    """

    def __init__(self, app: ASGIApp, wait_s: float) -> None:
        super().__init__(app)
        self._wait_s = wait_s

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        length = Headers(scope=scope).get("content-length", "0")
        announced = int(length) if length.isdecimal() else 0
        allowance = scope[BODY_ALLOWANCE] = BodyAllowance(announced)
        received, is_whole, wait_s = 0, False, self._wait_s

        async def receive_limited() -> Message:
            nonlocal received, is_whole
            if is_whole:  # only a disconnect can follow
                return await receive()
            try:
                with fail_after(min(wait_s, allowance.until - time.monotonic())):
                    message = await receive()
            except TimeoutError as exc:
                raise TooSlow(
                    f"no byte of the body arrived for {wait_s:g} s, or the body took "
                    "too long; send it again"
                ) from exc
            is_whole = not message.get("more_body", False)
            received += len(message.get("body", b""))
            allowance.check(max(received, announced))
            allowance.hold(received)
            return message

        try:
            await self._app(scope, receive_limited, send)
        finally:
            allowance.release()
