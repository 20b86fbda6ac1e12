"""Calls over HTTP: one pool of connections, the token, time-outs and retries.

Knows no call of the API. `RetryPolicy` and `Attempts` decide what happens after a
failure; the loops that send only wait and try again.
"""

from __future__ import annotations

import random
import ssl
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Final, TypeVar
from urllib.request import getproxies, proxy_bypass

import httpx

from unghost.client.call import Call, Params, query_of
from unghost.client.discovery import Server, is_local, refuse_foreign
from unghost.client.errors import Unavailable, error_of

T = TypeVar("T")

DEFAULT_TIMEOUT: Final = httpx.Timeout(60.0, connect=5.0)
"""A frame is decided while its upload waits, and a busy server does one after another.
"""

# A POST carries an Idempotency-Key, so that the server does it once only.
_REPEATABLE: Final = frozenset({"GET", "HEAD", "PUT", "DELETE", "POST"})


@dataclass(frozen=True)
class RetryPolicy:
    """How often a call is tried, and how long to wait in between.

    Delays grow from `base_s`, doubling, up to `longest_s`, and each is a random part of
    that ("full jitter"), so that clients which failed at the same moment do not come
    back at the same moment.
    """

    attempts: int = 4
    base_s: float = 0.2
    longest_s: float = 20.0

    def delay_s(self, attempt: int, retry_after_s: float | None = None) -> float:
        """Seconds to wait after `attempt` (from 1) failed.

        At least what the server asked for, up to a limit: a client that waits for an
        hour without a word looks like one that hangs.
        """
        ceiling = min(self.longest_s, self.base_s * 2 ** (attempt - 1))
        jitter = random.uniform(0, ceiling)
        if retry_after_s is None:
            return jitter
        return min(self.longest_s, retry_after_s + jitter)


class Attempts:
    """Counts how often something failed, and says how long to wait before the next try.

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
        """The seconds to wait after a failure; the error is raised after the last try.

        Parameters
        ----------
        error
            Why it failed.
        moved_on
            Whether something was achieved since the last failure: counting begins anew.
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
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._server = server
        # Redirects are not followed: the token would go along.
        self._http = httpx.Client(
            base_url=server.url,
            headers=headers,
            timeout=timeout,
            # A proxy for the network has no way to this machine.
            trust_env=not is_local(httpx.URL(server.url).host),
        )
        self.retry: Final = retry
        self._closed = threading.Event()

    def close(self) -> None:
        """Close the connections and stop every wait for a retry."""
        self._closed.set()
        self._http.close()

    @property
    def closed(self) -> bool:
        """No more calls."""
        return self._closed.is_set()

    def pause(self, seconds: float) -> bool:
        """Wait; True when calls can be sent, False at once when `close` is called."""
        return not self._closed.wait(seconds)

    def send(self, call: Call[T]) -> T:
        """What the call reads from the answer.

        Raises
        ------
        ApiError
            The answer is not a success, or none that can be read.
        httpx.TransportError
            There is no answer.
        """
        return call.read(self._answer(call))

    @contextmanager
    def stream(self, call: Call[T]) -> Iterator[T]:
        """What the call reads from an answer whose body has not come yet.

        It is sent once: the reader of the body decides what to send again.
        """
        response = self._http.send(self._request(call), stream=True)
        try:
            if not response.is_success:
                response.read()
            yield call.read(_success(response))
        finally:
            response.close()

    def endpoint(self, path: str, params: Params | None = None) -> Endpoint:
        """For a connection outside of the pool: where it sends POST requests to."""
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

    def _answer(self, call: Call[T]) -> httpx.Response:
        attempts = Attempts(self.retry, call.patience)
        repeatable = call.retried and call.method in _REPEATABLE
        # The same for each attempt, so that the server knows it for the same.
        key = uuid.uuid4().hex
        while True:
            try:
                return _success(self._http.send(self._request(call, key)))
            except (Unavailable, httpx.TransportError) as error:
                if not repeatable:
                    raise
                wait_s = attempts.failed(error)  # raises the error if it was the last
                if not self.pause(wait_s):
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
        # The server may have ended since, and its port be somebody else's.
        if event == "connection.connect_tcp.started":
            refuse_foreign(self._server)


def _success(response: httpx.Response) -> httpx.Response:
    if response.is_success:
        return response
    raise error_of(response)


@dataclass(frozen=True)
class Endpoint:
    """Where to connect, with which headers, and how long to wait.

    `check` is called before each connection, and raises where none is to be made.
    """

    url: httpx.URL
    headers: Mapping[str, str]
    timeout: httpx.Timeout
    tls: Callable[[], ssl.SSLContext] = field(default=httpx.create_ssl_context)
    check: Callable[[], None] = field(default=lambda: None)
