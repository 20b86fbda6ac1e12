"""Sends calls over HTTP: connection pool, token, time-outs and retries.

It is independent of the single calls of the API. `RetryPolicy` and `Attempts` decide
whether and when a failed call is retried; the loops that send only wait and retry.
"""

from __future__ import annotations

import random
import ssl
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeVar
from urllib.request import getproxies, proxy_bypass

import httpx

from unghost.client.call import Call, Params, query_of
from unghost.client.discovery import Server, is_local, refuse_foreign
from unghost.client.errors import NotFound, Unavailable, error_of, unexpected

T = TypeVar("T")

DEFAULT_TIMEOUT: Final = httpx.Timeout(60.0, connect=5.0)
"""Long: the response to an upload comes when its frame, perhaps queued, is decided."""

NO_RESPONSE: Final = "no response from"
"""The beginning of the message of an error that names the server."""

_PLAIN: Final = "identity"
_NOTHING_DONE: Final = frozenset({429, 503})
"""Statuses of a server that is too busy to have done anything."""
_NOT_SENT: Final = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout)


def address_of(url: httpx.URL) -> str:
    """The address of a server for messages: without a user and a password in it."""
    bare = url.copy_with(userinfo=b"", path="/", query=None, fragment=None)
    return str(bare).rstrip("/")


@dataclass(frozen=True)
class RetryPolicy:
    """How often a call is tried, and how long to wait in between.

    Delays double from `base_s` up to `longest_s`, and each is a random part of that
    ("full jitter"), so that clients that failed at the same moment do not retry at the
    same moment.
    """

    attempts: int = 4
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

    Parameters
    ----------
    policy
        How often to try, and how long to wait.
    patience
        A factor: multiplies the policy's number of attempts.
    """

    def __init__(self, policy: RetryPolicy, patience: int = 1) -> None:
        self._policy = policy
        self._most = policy.attempts * patience
        self._failed = 0

    def failed(
        self, error: Unavailable | httpx.TransportError, *, moved_on: bool = False
    ) -> float:
        """The seconds to wait after a failure; raises the error after the last attempt.

        Parameters
        ----------
        error
            The failure.
        moved_on
            Whether there was progress since the last failure; resets the count.
        """
        self._failed = 1 if moved_on else self._failed + 1
        if self._failed >= self._most:
            raise error
        asked = error.retry_after_s if isinstance(error, Unavailable) else None
        return self._policy.delay_s(self._failed, asked)


class Transport:
    """An HTTP connection pool to one server; safe to use from many threads."""

    def __init__(
        self,
        server: Server,
        *,
        timeout: float | httpx.Timeout,
        retry: RetryPolicy,
    ) -> None:
        token = server.token
        # A few compressed bytes could become gigabytes.
        headers = {"Accept-Encoding": _PLAIN}
        if token:
            headers["Authorization"] = f"Bearer {token}"
        address = httpx.URL(server.url)
        self._server = server
        # Redirects are not followed, because the token would be sent along.
        self._http = httpx.Client(
            base_url=server.url,
            headers=headers,
            timeout=timeout,
            # A proxy of the network cannot reach this machine's own address.
            trust_env=not is_local(address.host),
            # Certificates take longer to read than most calls. Without, none is valid.
            verify=address.scheme == "https" or ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT),
        )
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
        httpx.TransportError
            There is no response.
        """
        return call.read(self._response(call))

    @contextmanager
    def stream(self, call: Call[T]) -> Iterator[T]:
        """Send a call and return its result before the response's body is read.

        It is not retried: the caller, which reads the body, decides that.
        """
        response = self._head(self._request(call))
        try:
            refuse_encoded(response)
            if not response.is_success:
                response = whole(response, response.iter_raw(), call.max_bytes)
            yield call.read(_success(response))
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
        attempts = Attempts(self.retry, call.patience)
        # The same for each attempt, so that the server executes a POST only once.
        key = uuid.uuid4().hex
        may_be_done = False
        while True:
            response = None
            try:
                response = self._whole(call, key)
                return _success(response)
            except NotFound:
                if response is not None and call.method == "DELETE" and may_be_done:
                    return response  # deleted by an attempt whose response was lost
                raise
            except (Unavailable, httpx.TransportError) as error:
                may_be_done = may_be_done or not _was_refused(error)
                if not call.retried or (may_be_done and not call.repeatable):
                    raise
                wait_s = attempts.failed(error)  # may raise the error
                if not self.pause(wait_s):
                    raise

    def _whole(self, call: Call[T], key: str) -> httpx.Response:
        response = self._head(self._request(call, key))
        try:
            return whole(response, response.iter_raw(), call.max_bytes)
        finally:
            response.close()

    def _head(self, request: httpx.Request) -> httpx.Response:
        """Send a request; its response, whose body has not been read."""
        try:
            return self._http.send(request, stream=True)
        except httpx.TransportError as error:
            # Of the same type, since callers distinguish them; httpx names no address.
            why = str(error) or type(error).__name__
            error.args = (f"{NO_RESPONSE} {address_of(request.url)}: {why}",)
            raise

    def _request(self, call: Call[T], key: str | None = None) -> httpx.Request:
        headers = dict(call.headers)
        if key is not None and call.method == "POST":
            headers["Idempotency-Key"] = key
        return self._http.build_request(
            call.method,
            call.path,
            params=query_of(call.params),
            json=call.json,
            files=call.files,
            content=call.content,
            headers=headers,
            extensions={"trace": self._before_connecting},
        )

    def _before_connecting(self, event: str, _: object) -> None:
        # The server may have ended, and another user's program may have taken its port.
        if event == "connection.connect_tcp.started":
            refuse_foreign(self._server)


def _was_refused(error: Unavailable | httpx.TransportError) -> bool:
    """Whether the server has certainly not executed the call."""
    if isinstance(error, Unavailable):
        return error.status in _NOTHING_DONE
    return isinstance(error, _NOT_SENT)


def refuse_encoded(response: httpx.Response) -> None:
    """Raise UnexpectedAnswer if the body is compressed, which was not asked for."""
    encoding = response.headers.get("Content-Encoding", _PLAIN)
    if encoding.strip().lower() not in ("", _PLAIN):
        raise unexpected(response, f"is encoded as {encoding!r}")


def whole(
    head: httpx.Response, pieces: Iterable[bytes], max_bytes: int
) -> httpx.Response:
    """A response with its body, which is read from pieces.

    Raises
    ------
    UnexpectedAnswer
        It is compressed, or longer than `max_bytes`.
    """
    refuse_encoded(head)
    body = bytearray()
    for piece in pieces:
        body += piece
        if len(body) > max_bytes:
            raise unexpected(head, f"is longer than {max_bytes} bytes")
    return httpx.Response(
        head.status_code,
        headers=head.headers,
        content=bytes(body),
        request=head.request,
    )


def _success(response: httpx.Response) -> httpx.Response:
    if response.is_success:
        return response
    raise error_of(response)


@dataclass(frozen=True)
class Endpoint:
    """A URL with the headers and the time-outs of its requests.

    `check` is called before each connection, and raises if it must not be opened.
    """

    url: httpx.URL
    headers: Mapping[str, str]
    timeout: httpx.Timeout
    check: Callable[[], None]
