"""HTTP by a parser in C; what is not HTTP is answered with a problem as well.

The parser holds what it has not given on yet, and waits for as long as it takes. Nobody
has shown a token by then, so how much and how long is bounded here.
"""

from __future__ import annotations

import asyncio
import uuid
from http import HTTPStatus
from typing import Final, cast

from fastapi import FastAPI
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from app.http_errors import PROBLEM_TYPE, Problem
from app.logs import Answered, known_as, log_answer
from app.settings import Settings

MOST_UNWANTED: Final = 1 << 26
"""Bytes of a body that are read after its request was answered."""
_MALFORMED: Final = Problem(
    400, "malformed_http", "this is no request in HTTP/1.1 with a known method"
)


class Pieces:
    """What has arrived of a body and was not asked for yet.

    Uvicorn copies each piece into an array and the array into the message. A batch is
    gigabytes: here a piece that is asked for before the next one comes is not copied.
    """

    def __init__(self) -> None:
        self._pieces: list[bytes] = []
        self._size = 0

    def __iadd__(self, piece: bytes) -> Pieces:
        self._pieces.append(piece)
        self._size += len(piece)
        return self

    def __len__(self) -> int:
        return self._size

    def __bytes__(self) -> bytes:
        return self._pieces[0] if len(self._pieces) == 1 else b"".join(self._pieces)


class ProblemProtocol(HttpToolsProtocol):
    """Uvicorn's HTTP/1.1, but for the answer to what it cannot parse, and bounded."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Wait for the first request, but not for ever."""
        settings: Settings = cast("FastAPI", self.config.app).state.settings
        self._most = int(settings.max_head_bytes)
        self._head_wait_s = settings.head_wait_s
        self._body_wait_s = settings.body_wait_s
        self._held = self._unwanted = 0
        self._gives = self._has_begun = False
        self._fault = _MALFORMED
        self._patience: asyncio.TimerHandle | None = None
        super().connection_made(cast("asyncio.Transport", transport))
        self._be_patient(self._head_wait_s)

    def connection_lost(self, exc: Exception | None) -> None:
        """Nobody is waited for any more."""
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Parse; what the parser keeps to itself may not grow without end."""
        self._gives = False
        super().data_received(data)
        self._held = 0 if self._gives else self._held + len(data)
        if self._held > self._most:
            self._refuse(self._too_long())

    def on_message_begin(self) -> None:
        """A request begins: the first one, or another on the same connection."""
        super().on_message_begin()
        self._has_begun = True
        self._unwanted = 0
        if self._patience is None:
            self._be_patient(self._head_wait_s)

    def on_headers_complete(self) -> None:
        """The service takes over, unless the head is too long."""
        self._gives, self._has_begun = True, False
        self._stop_waiting()
        size = len(self.url) + sum(
            len(name) + len(value) for name, value in self.headers
        )
        if size > self._most:
            self._fault = self._too_long()
            raise ValueError(self._fault.detail)  # the parser stops, and we answer
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """A piece of a body, which has limits of its own."""
        self._gives = True
        if self.cycle.response_complete:
            self._pass_over(body)
            return
        if not self.cycle.body:
            self.cycle.body = cast("bytearray", Pieces())
        super().on_body(body)

    def _pass_over(self, body: bytes) -> None:
        # Who still sends reads its answer late, if at all; but not for ever.
        self._unwanted += len(body)
        if self._unwanted > MOST_UNWANTED:
            self.transport.close()

    def on_message_complete(self) -> None:
        """The end of a request."""
        self._gives = True
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Wait for the rest of a body that nobody wants, or for the next request."""
        is_whole = not self.cycle.more_body
        self._be_patient(self._head_wait_s if is_whole else self._body_wait_s)
        super().on_response_complete()

    def send_400_response(self, msg: str) -> None:
        """Answer and hang up. No request exists yet, so no middleware sees this."""
        self._refuse(self._fault)

    def _be_patient(self, seconds: float) -> None:
        self._stop_waiting()
        self._patience = self.loop.call_later(seconds, self._lose_patience)

    def _stop_waiting(self) -> None:
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None

    def _lose_patience(self) -> None:
        self._patience = None
        if self._is_answering():
            return  # whatever was begun meanwhile waits its turn
        if self._has_begun:
            detail = f"the request's head did not arrive within {self._head_wait_s:g} s"
            status = HTTPStatus.REQUEST_TIMEOUT
            self._refuse(Problem(status, "request_timeout", detail))
        elif not self.transport.is_closing():
            self.transport.close()

    def _is_answering(self) -> bool:
        # Before the first request there is no cycle, whatever its type says.
        return not getattr(self.cycle, "response_complete", True)

    def _too_long(self) -> Problem:
        return Problem(
            HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE,
            "head_too_large",
            f"the request's head is larger than {self._most} bytes",
        )

    def _refuse(self, problem: Problem) -> None:
        if self.transport.is_closing():
            return
        if self._is_answering():  # another answer is on its way: only hang up
            self.transport.close()
            return
        request_id = uuid.uuid4().hex
        answer = problem.response(instance="", request_id=request_id)
        client = self.client[0] if self.client else None
        with known_as(request_id):
            log_answer(Answered("-", "-", None, problem.status, 0.0, None, client))
        status = HTTPStatus(problem.status)
        head = (
            f"HTTP/1.1 {status.value} {status.phrase}",
            f"content-type: {PROBLEM_TYPE}",
            f"content-length: {len(answer.body)}",
            "x-content-type-options: nosniff",
            f"x-request-id: {request_id}",
            "connection: close",
        )
        self.transport.write("\r\n".join((*head, "", "")).encode())
        self.transport.write(bytes(answer.body))
        self.transport.close()
