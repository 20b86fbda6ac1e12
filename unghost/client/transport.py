"""Sends calls over HTTP: connection pool, token, time-outs and retries.

It is independent of the single calls of the API. `RetryPolicy` and `Attempts` decide
whether and when a failed call is retried; the loops that send only wait and retry.
"""

from __future__ import annotations

import asyncio
import logging
import random
import ssl
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypeVar
from urllib.request import getproxies, proxy_bypass

import httpx

from unghost.client import errors
from unghost.client.call import Call, Params, query_of
from unghost.client.discovery import Server, found_again, is_local, refuse_foreign

T = TypeVar("T")

DEFAULT_TIMEOUT: Final = httpx.Timeout(60.0, connect=5.0)
"""Long: the response to an upload comes when its frame, perhaps queued, is decided."""

_PLAIN: Final = "identity"
_NOTHING_DONE: Final = frozenset({429, 503})
"""Statuses of a server that is too busy to have done anything."""
_NOT_SENT: Final = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout)

_QUIET_S: Final = 1.0
"""A shorter outage is not worth a message."""

_log: Final = logging.getLogger("unghost.client")


def address_of(url: httpx.URL) -> str:
    """The address of a server for messages: without a user and a password in it."""
    bare = url.copy_with(userinfo=b"", path="/", query=None, fragment=None)
    return str(bare).rstrip("/")


def no_response(
    url: httpx.URL, error: Exception, *, sent: bool | None = None
) -> errors.NoResponse:
    """The exception for a connection that failed; httpx's own names no address."""
    if sent is None:
        sent = not isinstance(error, _NOT_SENT)
    why = str(error) or type(error).__name__
    return errors.NoResponse(address_of(url), why, sent=sent)


@dataclass(frozen=True)
class RetryPolicy:
    """How long a failed call is tried again, and how long to wait in between.

    `for_s` are the seconds from the first failure, or from the last progress of an
    operation of many calls; 0 means one attempt. Delays double from `base_s` up to
    `longest_s`, and each is a random part of that ("full jitter"), so that clients that
    failed at the same moment do not retry at the same moment.
    """

    for_s: float = 120.0
    base_s: float = 0.2
    longest_s: float = 20.0

    def delay_s(self, attempt: int, retry_after_s: float | None = None) -> float:
        """Seconds to wait after `attempt` (from 1) failed.

        At least the server's `Retry-After`, up to a limit: a client that waits silently
        for an hour looks as if it hangs.
        """
        ceiling = min(self.longest_s, self.base_s * 2 ** (attempt - 1))
        jitter = random.uniform(0, ceiling)
        if retry_after_s is None:
            return jitter
        return min(self.longest_s, retry_after_s + jitter)


class Attempts:
    """Counts failures, and computes how long to wait before the next attempt.

    An outage of more than a second is logged once, because the caller may wait long.
    """

    def __init__(self, policy: RetryPolicy) -> None:
        self._policy = policy
        self._failed = 0
        self._since = 0.0
        self._is_logged = False

    def failed(self, error: errors.Unavailable, *, moved_on: bool = False) -> float:
        """The seconds to wait after a failure; raises the error when the time is over.

        `moved_on`: there was progress since the last failure, so the time starts again.
        """
        now = time.monotonic()
        if moved_on or not self._failed:
            self._failed, self._since, self._is_logged = 0, now, False
        self._failed += 1
        tried_s = now - self._since
        left_s = self._policy.for_s - tried_s
        if left_s <= 0:
            if self._failed > 1:
                error.extend(f"gave up after {tried_s:.0f} s")
            raise error
        if tried_s >= _QUIET_S and not self._is_logged:
            self._is_logged = True
            _log.warning("%s; trying again for up to %.0f s", error, left_s)
        return min(left_s, self._policy.delay_s(self._failed, error.retry_after_s))


class _Tries:
    """The attempts of one call: which error ends it, and how long to wait for the next.

    `key` is the same for each attempt, so that the server executes a POST only once.
    """

    def __init__(self, call: Call[T], retry: RetryPolicy) -> None:
        self._call = call
        self._attempts = Attempts(retry)
        self._may_be_done = False
        self.key = uuid.uuid4().hex

    def has_deleted(self) -> bool:
        """Whether an attempt may have deleted what is not found, its response lost."""
        return self._call.method == "DELETE" and self._may_be_done

    def wait_s(self, error: errors.Unavailable) -> float:
        """Seconds to wait for the next attempt; raises the error if there is none."""
        self._may_be_done |= (
            error.sent
            if isinstance(error, errors.NoResponse)
            else error.status not in _NOTHING_DONE
        )
        if not self._call.retried or (self._may_be_done and not self._call.repeatable):
            raise error
        return self._attempts.failed(error)


def _headers(server: Server) -> dict[str, str]:
    # A few compressed bytes could become gigabytes.
    headers = {"Accept-Encoding": _PLAIN}
    if server.token:
        headers["Authorization"] = f"Bearer {server.token}"
    return headers


def _pool_options(server: Server, timeout: float | httpx.Timeout) -> dict[str, Any]:
    """What a pool of httpx is made with; a token is for this server alone."""
    address = httpx.URL(server.url)
    return {
        "base_url": server.url,
        "headers": _headers(server),
        "timeout": timeout,
        # A proxy of the network cannot reach this machine's own address.
        "trust_env": not is_local(address.host),
        # Certificates take longer to read than most calls. Without, none is valid.
        "verify": address.scheme == "https" or ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT),
        "follow_redirects": False,
    }


def _request(
    http: httpx.Client | httpx.AsyncClient,
    call: Call[T],
    trace: Callable[[str, object], object],
    key: str | None = None,
) -> httpx.Request:
    headers = dict(call.headers)
    if key is not None and call.method == "POST":
        headers["Idempotency-Key"] = key
    return http.build_request(
        call.method,
        call.path,
        params=query_of(call.params),
        json=call.json,
        files=call.files,
        content=call.content,
        headers=headers,
        extensions={"trace": trace},
    )


_CONNECTING: Final = "connection.connect_tcp.started"


class AsyncTransport:
    """Sends calls as `Transport` does, without blocking the event loop."""

    def __init__(
        self, server: Server, *, timeout: float | httpx.Timeout, retry: RetryPolicy
    ) -> None:
        self._server = server
        self._retry = retry
        self._http = httpx.AsyncClient(**_pool_options(server, timeout))

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def send(self, call: Call[T]) -> T:
        """Send a call and return its result; see `Transport.send`."""
        tries = _Tries(call, self._retry)
        while True:
            response, server = None, self._server
            try:
                response = await self._whole(call, tries.key)
                return call.read(_success(response))
            except errors.NotFound:
                if response is not None and tries.has_deleted():
                    return call.read(response)
                raise
            except errors.Unauthorized:
                if (renewed := found_again(server)) is None:
                    raise
                self._server = renewed
                self._http.headers.update(_headers(renewed))
            except errors.Unavailable as error:
                await asyncio.sleep(tries.wait_s(error))

    async def _whole(self, call: Call[T], key: str) -> httpx.Response:
        request = _request(self._http, call, self._before_connecting, key)
        try:
            response = await self._http.send(request, stream=True)
            try:
                refuse_encoded(response)
                body, most = bytearray(), call.max_bytes
                async for piece in response.aiter_raw():
                    body += piece
                    if len(body) > most:
                        raise errors.unexpected(
                            response, f"is longer than {most} bytes"
                        )
            finally:
                await response.aclose()
        except httpx.TransportError as error:
            raise no_response(request.url, error) from error
        return whole(response, [bytes(body)], most)

    async def _before_connecting(self, event: str, _: object) -> None:
        if event == _CONNECTING:
            refuse_foreign(self._server)


class Transport:
    """An HTTP connection pool to one server; safe to use from many threads."""

    def __init__(
        self, server: Server, *, timeout: float | httpx.Timeout, retry: RetryPolicy
    ) -> None:
        self._server = server
        self._http = httpx.Client(**_pool_options(server, timeout))
        self.retry: Final = retry
        self._closed = threading.Event()

    def close(self) -> None:
        """Close the connections and stop every wait for a retry."""
        self._closed.set()
        self._http.close()

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed.is_set()

    def pause(self, seconds: float) -> bool:
        """Wait, then return True; returns False at once when `close` is called."""
        return not self._closed.wait(seconds)

    def send(self, call: Call[T]) -> T:
        """Send a call and return its result.

        Raises
        ------
        ApiError
            The response is not a success, or cannot be read.
        NoResponse
            There is none, or it was cut.
        """
        return call.read(self._response(call))

    @contextmanager
    def stream(self, call: Call[T]) -> Iterator[T]:
        """Send a call and return its result before the response's body is read.

        It is not retried: the caller, which reads the body, decides that.
        """
        response = self._head(_request(self._http, call, self._before_connecting))
        try:
            refuse_encoded(response)
            if not response.is_success:
                response = whole(response, response.iter_raw(), call.max_bytes)
            yield call.read(_success(response))
        except httpx.TransportError as error:
            raise no_response(response.url, error) from error
        finally:
            response.close()

    def endpoint(self, path: str, params: Params | None = None) -> Endpoint:
        """The endpoint of POST requests, for a connection outside of the pool."""
        request = self._http.build_request("POST", path, params=query_of(params or {}))
        kept = ("authorization", "user-agent")
        headers = {
            name: request.headers[name] for name in kept if name in self._http.headers
        }
        return Endpoint(
            request.url,
            headers,
            self._http.timeout,
            check=partial(refuse_foreign, self._server),
        )

    @property
    def behind_proxy(self) -> bool:
        """Whether calls go through a proxy, which another connection would bypass."""
        url = self._http.base_url
        named = getproxies()
        return self._http.trust_env and bool(
            (url.scheme in named or "all" in named) and not proxy_bypass(url.host)
        )

    def _response(self, call: Call[T]) -> httpx.Response:
        tries = _Tries(call, self.retry)
        while True:
            response, server = None, self._server
            try:
                response = self._whole(call, tries.key)
                return _success(response)
            except errors.NotFound:
                if response is not None and tries.has_deleted():
                    return response
                raise
            except errors.Unauthorized:
                # Another thread may have found it: this call was sent without.
                if (renewed := found_again(server)) is None:
                    raise
                self._server = renewed
                self._http.headers.update(_headers(renewed))
            except errors.Unavailable as error:
                wait_s = tries.wait_s(error)  # may raise the error
                if not self.pause(wait_s):
                    raise

    def _whole(self, call: Call[T], key: str) -> httpx.Response:
        response = self._head(_request(self._http, call, self._before_connecting, key))
        try:
            return whole(response, response.iter_raw(), call.max_bytes)
        except httpx.TransportError as error:
            raise no_response(response.url, error) from error
        finally:
            response.close()

    def _head(self, request: httpx.Request) -> httpx.Response:
        """Send a request; its response, whose body has not been read."""
        try:
            return self._http.send(request, stream=True)
        except httpx.TransportError as error:
            raise no_response(request.url, error) from error

    def _before_connecting(self, event: str, _: object) -> None:
        # The server may have ended, and another user's program may have taken its port.
        if event == _CONNECTING:
            refuse_foreign(self._server)


def refuse_encoded(response: httpx.Response) -> None:
    """Raise UnexpectedAnswer if the body is compressed, which was not asked for."""
    encoding = response.headers.get("Content-Encoding", _PLAIN)
    if encoding.strip().lower() not in ("", _PLAIN):
        raise errors.unexpected(response, f"is encoded as {encoding!r}")


def whole(
    head: httpx.Response, pieces: Iterable[bytes], max_bytes: int
) -> httpx.Response:
    """A response with its body, which is read from pieces.

    Raises UnexpectedAnswer if it is compressed, or longer than `max_bytes`.
    """
    refuse_encoded(head)
    body = bytearray()
    for piece in pieces:
        body += piece
        if len(body) > max_bytes:
            raise errors.unexpected(head, f"is longer than {max_bytes} bytes")
    return httpx.Response(
        head.status_code,
        headers=head.headers,
        content=bytes(body),
        request=head.request,
    )


def _success(response: httpx.Response) -> httpx.Response:
    if response.is_success:
        return response
    raise errors.error_of(response)


@dataclass(frozen=True)
class Endpoint:
    """A URL with the headers and the time-outs of its requests.

    `check` is called before each connection, and raises if it must not be opened.
    """

    url: httpx.URL
    headers: Mapping[str, str]
    timeout: httpx.Timeout
    check: Callable[[], None]
