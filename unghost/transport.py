"""One request, with the token, the retries and the errors; knows no endpoint."""

from __future__ import annotations

import threading
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final
from urllib.request import getproxies, proxy_bypass

import httpx

from unghost.discovery import Server, is_local, refuse_foreign
from unghost.duplex import Endpoint
from unghost.errors import error_of, json_object, unexpected
from unghost.retry import RETRIED_STATUS, RetryPolicy, retry_after_s

API: Final = "/api/v1"
# A POST carries an Idempotency-Key, so that the server does it once only.
_REPEATABLE: Final = frozenset({"GET", "HEAD", "PUT", "DELETE", "POST"})

Params = Mapping[str, Any]
Files = Mapping[str, tuple[str, bytes, str]]


@dataclass(frozen=True)
class Call:
    """A request that can be sent more than once: its bodies are values, not streams.

    It is sent `patience` times as often as the policy says.
    """

    method: str
    path: str
    params: Params = field(default_factory=dict)
    json: object = None
    files: Files | None = None
    content: bytes | None = None
    headers: Mapping[str, str] = field(default_factory=dict)
    retried: bool = True
    patience: int = 1


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

    def endpoint(self, path: str, params: Params | None = None) -> Endpoint:
        """Where a connection of its own sends to, past the pool."""
        request = self._http.build_request("POST", path, params=_query(params or {}))
        kept = ("authorization", "user-agent")
        headers = {
            name: request.headers[name] for name in kept if name in self._http.headers
        }
        return Endpoint(
            request.url,
            headers,
            self._http.timeout.read,
            check=partial(refuse_foreign, self._server),
        )

    @property
    def behind_proxy(self) -> bool:
        """Whether calls take a way that a connection of its own would not know."""
        url = self._http.base_url
        named = getproxies()
        return self._http.trust_env and bool(
            (url.scheme in named or "all" in named) and not proxy_bypass(url.host)
        )

    def pause(self, seconds: float) -> None:
        """Wait, but not longer than until `close`."""
        self._closed.wait(seconds)

    def send(self, call: Call) -> httpx.Response:
        """The response, if it is a success; else the exception that it stands for."""
        request = self._request(call)
        attempt = 1
        while True:
            try:
                response = self._http.send(request)
            except httpx.TransportError:
                if not self._again(call, attempt):
                    raise
                self.pause(self.retry.delay_s(attempt))
            else:
                busy = response.status_code in RETRIED_STATUS
                if not busy or not self._again(call, attempt):
                    return _success(response)
                asked = retry_after_s(response.headers.get("Retry-After"))
                self.pause(self.retry.delay_s(attempt, asked))
            attempt += 1
            request = self._request(call, key=request.headers.get("Idempotency-Key"))

    def json(self, call: Call) -> Mapping[str, Any]:
        """The JSON object of a successful answer."""
        return body_of(self.send(call))

    @contextmanager
    def stream(self, call: Call) -> Iterator[httpx.Response]:
        """A response whose body has not been read; who reads it resumes by itself."""
        request = self._request(call)
        response = self._http.send(request, stream=True)
        try:
            if not response.is_success:
                response.read()
            yield _success(response)
        finally:
            response.close()

    def _request(self, call: Call, key: str | None = None) -> httpx.Request:
        headers = dict(call.headers)
        if call.method == "POST":
            headers["Idempotency-Key"] = key or uuid.uuid4().hex
        return self._http.build_request(
            call.method,
            call.path,
            params=_query(call.params),
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

    def _again(self, call: Call, attempt: int) -> bool:
        if not call.retried or call.method not in _REPEATABLE:
            return False
        return (
            attempt < call.patience * self.retry.attempts and not self._closed.is_set()
        )


def body_of(response: httpx.Response) -> Mapping[str, Any]:
    """The JSON object of a response."""
    body = json_object(response)
    if body is None:
        raise unexpected(response, "is not a JSON object")
    return body


def _success(response: httpx.Response) -> httpx.Response:
    if response.is_success:
        return response
    raise error_of(response)


def _query(params: Params) -> dict[str, Any]:
    given = {key: value for key, value in params.items() if value is not None}
    return {
        key: str(value).lower() if isinstance(value, bool) else value
        for key, value in given.items()
    }
