"""Extends uvicorn by limits that hold before a token is checked, and a graceful stop.

uvicorn limits neither the size of a request's head, nor the time in which it arrives,
nor the time that a client takes to read, and it stops listening before it has sent the
last response. So this module extends `uvicorn.Server`, `HttpToolsProtocol` and
`RequestResponseCycle`; `tests/api/process` tests the internals that it uses.
"""

from __future__ import annotations

import asyncio
import faulthandler
import os
import select
import signal
import socket
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from types import FrameType
from typing import Final, cast

import uvicorn
from fastapi import FastAPI
from uvicorn._types import ASGI3Application
from uvicorn.protocols.http.httptools_impl import (
    HttpToolsProtocol,
    RequestResponseCycle,
)

from app.http.problems import PROBLEM_TYPE, Refusal
from app.incoming import Pieces
from app.logs import AccessRecord, log_access, logged_with, server_log
from app.process.connections import MOST_TURNED_AWAY, Connections
from app.settings import Settings

LAST_S: Final = 15
"""Seconds after the time for requests until the process ends by force."""
_POLL_S: Final = 0.05


class GracefulServer(uvicorn.Server):
    """Uvicorn; the first signal lets open requests finish, the second ends it at once.

    While they finish, the server still listens: health checks get a response, and new
    requests that write are refused with 503.
    """

    def __init__(
        self,
        config: uvicorn.Config,
        *,
        ready: Callable[[], None],
        stopping: Callable[[], None],
        wait_s: float,
    ) -> None:
        super().__init__(config)
        self._ready, self._stopping, self._wait_s = ready, stopping, wait_s
        self.failure: Exception | None = None
        """The error of `ready`, which ended the server."""

    async def main_loop(self) -> None:
        """Call `ready`, and serve; if it fails, the server shuts down."""
        try:
            # In a thread: it writes to the database, which may block.
            await asyncio.to_thread(self._ready)
        except Exception as exc:
            self.failure = exc
            return
        await super().main_loop()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Call `stopping`, let open requests finish for a while, and stop listening."""
        until = time.monotonic() + self._wait_s
        begun = set(self.server_state.tasks)
        server_log.info("stopping; %d requests are still open", len(begun))

        def end() -> None:
            server_log.error("the shutdown took too long: the process ends by force")
            os._exit(1)

        watchdog = threading.Timer(self._wait_s + LAST_S, end)
        watchdog.daemon = True
        watchdog.start()
        self._stopping()
        while time.monotonic() < until and not all(task.done() for task in begun):
            await asyncio.sleep(_POLL_S)
        late = [task for task in begun if not task.done()]
        left_s = max(1, int(until - time.monotonic()))
        self.config.timeout_graceful_shutdown = left_s
        if late:
            count = len(late)
            server_log.warning("%d requests are cancelled: they took too long", count)
            for task in late:
                task.cancel()
            await asyncio.wait(late, timeout=1)  # for the errors to their clients
        await super().shutdown(sockets)
        faulthandler.cancel_dump_traceback_later()
        server_log.info("stopped")

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Stop, or end at once on a second signal: acknowledged writes are durable."""
        if self.should_exit:
            with suppress(RuntimeError):  # the signal may interrupt another log line
                server_log.warning("a second signal: the process ends at once")
            os._exit(128 + sig)
        # If the event loop hangs, it never handles the signal. This takes no lock.
        with suppress(ValueError, OSError, AttributeError):
            faulthandler.dump_traceback_later(self._wait_s + 2 * LAST_S, exit=True)
        super().handle_exit(sig, frame)


def exit_on_sigterm() -> None:
    """Make SIGTERM end the process with exit status 0; a second one kills it."""
    if threading.current_thread() is threading.main_thread():

        def end(*_: object) -> None:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            raise SystemExit(0)

        signal.signal(signal.SIGTERM, end)


MAX_DISCARDED_BYTES: Final = 1 << 26
"""Bytes of a body that are read and discarded after the response was sent."""
MOST_HEADERS: Final = 100
"""Headers of a request; each costs some 200 bytes of memory, however short it is."""
CHUNK_BYTES: Final = 16
"""How much each chunk of a body may take beside its content: its size, line breaks."""
MOST_PIPELINED: Final = 32
"""Requests that wait on one connection behind the one that is being processed."""
_FULL_RETRY_S: Final = 5
_TURN_AWAY_S: Final = 1.0
"""How long a client that is refused may take to read the response."""
_MALFORMED: Final = Refusal(
    400, "malformed_http", "this is not an HTTP/1.1 request with a known method"
)


class _Timer:
    """Calls a function once, some time after its latest start."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, call: Callable[[], None]
    ) -> None:
        self._loop, self._call = loop, call
        self._pending: asyncio.TimerHandle | None = None

    @property
    def is_running(self) -> bool:
        """Whether the call is pending."""
        return self._pending is not None

    def start(self, seconds: float) -> None:
        """Call the function after this time, and not at an earlier start's."""
        self.stop()

        def end() -> None:
            self._pending = None
            self._call()

        self._pending = self._loop.call_later(seconds, end)

    def stop(self) -> None:
        """Cancel the call, if it is pending."""
        if self._pending is not None:
            self._pending.cancel()
            self._pending = None


class ProblemProtocol(HttpToolsProtocol):
    """Uvicorn's HTTP/1.1 with limits, and a problem document for malformed requests.

    asyncio calls `connection_made`, `data_received` and `connection_lost`. Uvicorn's
    `data_received` passes the bytes to httptools, which calls `on_message_begin`,
    `on_headers_complete`, `on_body` and `on_message_complete` for each request, and
    uvicorn calls `on_response_complete`. Its `cycle` is the request whose head was
    complete last; `_answered` is the one that is being processed, for which those in
    `pipeline` wait.

    A connection is in one of these states, or in the second and the third at once, as a
    client may send its next request before it has the response to the last:

    **Waiting for a head**: neither `_has_begun` nor `_is_answering()`. From
    `connection_made` or `on_response_complete` on. The rest of a body whose response
    was sent is discarded meanwhile (`on_body`). When the timer runs out, the connection
    is closed; `Connections` may close it earlier, to make room.

    **Head arriving**: `_has_begun`. From `on_message_begin` to `on_headers_complete`.
    The timer of the state before goes on; when it runs out, the request is refused.

    **Request in progress**: `_is_answering()`. From `on_headers_complete` to the
    `on_response_complete` after which no request waits. The timer has no effect.

    **Refused**, until `connection_lost`. Three attributes say so:

    - `_is_turned_away`, by `connection_made`: there are too many connections. It is
      closed when the client sends something, or after `_TURN_AWAY_S`.
    - `_asks_too_much`, by `on_message_begin`: too many requests wait. Nothing more is
      parsed; they get their responses, and the last one closes the connection.
    - ``transport.is_closing()``, by `_refuse`: a head is too long (`data_received`) or
      late (`_on_timeout`), or the parser has stopped (`send_400_response`), by itself
      or as `on_header` or `on_headers_complete` found the head too long. If a response
      is being sent, the connection is closed without another one.
    """

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Wait for the first request, for a limited time; or refuse the connection."""
        state = cast("FastAPI", self.config.app).state
        settings: Settings = state.settings
        self._connections: Connections = state.connections
        self._max_head_bytes = int(settings.max_head_bytes)
        self._head_wait_s = settings.head_wait_s
        self._body_wait_s = settings.body_wait_s
        self._has_begun = self._is_turned_away = self._asks_too_much = False
        self._is_signed_in = False  # whether an earlier request was, see `is_known`
        self._overhead = 0  # bytes of a head, or of a body beside its content
        self._discarded = 0  # bytes of a body after its response
        self._fault = _MALFORMED  # the refusal if the parser stops
        self._timer = _Timer(self.loop, self._on_timeout)
        self._answered: RequestResponseCycle | None = None
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            # Linux disconnects a client that has read nothing of a response for so
            # long. It would keep the rest in memory for as long as it likes.
            milliseconds = int(settings.answer_wait_s * 1000)
            connection: socket.socket = transport.get_extra_info("socket")
            connection.setsockopt(
                socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, milliseconds
            )
        super().connection_made(cast("asyncio.Transport", transport))
        refusal = self._connections.refusal(self)
        if refusal is None:
            self._timer.start(self._head_wait_s)
        else:
            self._turn_away(refusal)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timer, and notify the request that is being processed."""
        self._timer.stop()
        self._connections.leave(self)
        answered = self._answered
        if answered is not None and not answered.response_complete:
            # Uvicorn notifies only the newest request, which may wait behind this one.
            answered.disconnected = True
            answered.message_event.set()
        super().connection_lost(exc)

    @property
    def is_known(self) -> bool:
        """Whether a valid token or session was sent on this connection."""
        return self._is_signed_in or _is_signed_in(self._answered)

    @property
    def is_quiet(self) -> bool:
        """Whether no bytes wait to be read or to be sent."""
        if self.transport.get_write_buffer_size():
            return False
        if not hasattr(select, "poll"):  # on Windows, unread bytes are not noticed
            return True
        unread = select.poll()
        unread.register(self.transport.get_extra_info("socket").fileno(), select.POLLIN)
        return not unread.poll(0)

    def give_way(self) -> None:
        """Close at once, to make room for another connection."""
        self.transport.abort()

    def _turn_away(self, refusal: str) -> None:
        if len(self._connections.turned_away) >= MOST_TURNED_AWAY:
            self.transport.abort()
            return
        self._is_turned_away = True
        self._connections.turned_away.add(self)
        headers = {"Retry-After": str(_FULL_RETRY_S)}
        status = HTTPStatus.SERVICE_UNAVAILABLE
        self._send(Refusal(status, "too_many_connections", refusal, headers=headers))
        # If it were closed with unread data, some systems would drop the response.
        self.transport.write_eof()
        self._timer.start(_TURN_AWAY_S)

    def data_received(self, data: bytes) -> None:
        """Parse, and limit what is sent beside the content of bodies."""
        if self._is_turned_away:
            self.transport.close()
            return
        self._overhead += len(data)
        super().data_received(data)
        self._overhead = max(0, self._overhead)
        if self._overhead > self._max_head_bytes and not self._asks_too_much:
            self._refuse(self._too_long())

    def on_message_begin(self) -> None:
        """A request begins: the first one, or another on the same connection."""
        if len(self.pipeline) >= MOST_PIPELINED:
            self._asks_too_much = True
            raise ValueError("too many requests wait")  # the parser stops
        super().on_message_begin()
        self._has_begun = True
        self._discarded = 0
        self._connections.work(self)
        if not self._timer.is_running:
            self._timer.start(self._head_wait_s)

    def on_header(self, name: bytes, value: bytes) -> None:
        """A header of the head; those after the body (trailers) are discarded."""
        if not self._has_begun:
            return
        if len(self.headers) >= MOST_HEADERS:
            self._fault = self._too_long(f"has more than {MOST_HEADERS} headers")
            raise ValueError(self._fault.detail)  # stops the parser; we send an error
        super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Pass the request to the service, unless its head is too long."""
        self._overhead, self._has_begun = 0, False
        self._timer.stop()
        size = len(self.url) + sum(
            len(name) + len(value) for name, value in self.headers
        )
        if size > self._max_head_bytes:
            self._fault = self._too_long()
            raise ValueError(self._fault.detail)  # stops the parser; we send an error
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Pass on a piece of a body, which the service limits; discard late ones."""
        self._overhead -= len(body) + CHUNK_BYTES
        if self.cycle.response_complete:
            # Clients may read the response only after sending all; that has a limit.
            self._discarded += len(body)
            if self._discarded > MAX_DISCARDED_BYTES:
                self.transport.close()
            return
        if not self.cycle.body:
            self.cycle.body = cast("bytearray", Pieces())
        super().on_body(body)

    def on_message_complete(self) -> None:
        """The end of a request."""
        self._overhead = 0
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Wait for the rest of a body, which is discarded, or for the next request."""
        self._is_signed_in = self.is_known
        is_whole = not self.cycle.more_body
        self._timer.start(self._head_wait_s if is_whole else self._body_wait_s)
        super().on_response_complete()
        if self.pipeline:  # process waiting requests before reading more
            self.flow.pause_reading()
        elif not self._has_begun and not self._is_answering():
            self._connections.wait(self)

    def _start_asgi_task(
        self, cycle: RequestResponseCycle, app: ASGI3Application
    ) -> None:
        self._answered = cycle
        super()._start_asgi_task(cycle, app)

    def send_400_response(self, msg: str) -> None:
        """Send an error and close; without a request, no middleware is involved."""
        if self._asks_too_much:
            # Accepted requests get their responses; the client has to repeat the rest.
            self.cycle.keep_alive = False
            self.flow.pause_reading()
        else:
            self._refuse(self._fault)

    def _on_timeout(self) -> None:
        if self._is_answering():
            return  # a request is being processed; the next one has to wait
        if self._has_begun:
            detail = f"the request's head did not arrive within {self._head_wait_s:g} s"
            status = HTTPStatus.REQUEST_TIMEOUT
            self._refuse(Refusal(status, "request_timeout", detail))
        elif not self.transport.is_closing():
            self.transport.close()

    def _is_answering(self) -> bool:
        # Before the first request, `cycle` is None in spite of its declared type.
        return not getattr(self.cycle, "response_complete", True)

    def _too_long(self, why: str = "") -> Refusal:
        return Refusal(
            HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE,
            "head_too_large",
            "the request's head "
            + (why or f"is larger than {self._max_head_bytes} bytes"),
        )

    def _refuse(self, refusal: Refusal) -> None:
        if self.transport.is_closing():
            return
        if not self._is_answering():  # else only close: a response is being sent
            self._send(refusal)
        self.transport.close()

    def _send(self, refusal: Refusal) -> None:
        request_id = uuid.uuid4().hex
        answer = refusal.response(instance="", request_id=request_id)
        with logged_with(request_id):
            client = self.client[0] if self.client else None
            log_access(AccessRecord("-", "-", None, refusal.status, 0.0, None, client))
        status = HTTPStatus(refusal.status)
        head = (
            f"HTTP/1.1 {status.value} {status.phrase}",
            f"content-type: {PROBLEM_TYPE}",
            f"content-length: {len(answer.body)}",
            *(f"{name.lower()}: {value}" for name, value in refusal.headers.items()),
            "x-content-type-options: nosniff",
            f"x-request-id: {request_id}",
            "connection: close",
        )
        self.transport.write("\r\n".join((*head, "", "")).encode())
        self.transport.write(bytes(answer.body))


def _is_signed_in(cycle: RequestResponseCycle | None) -> bool:
    return cycle is not None and "principal" in cycle.scope.get("state", {})
