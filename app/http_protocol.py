"""What is answered to bytes that are not HTTP: a problem as well."""

from __future__ import annotations

import uuid
from typing import Final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from app.http_errors import PROBLEM_TYPE, Problem

_PROBLEM: Final = Problem(400, "malformed_http", "this is not a request in HTTP/1.1")


class ProblemProtocol(H11Protocol):
    """Uvicorn's HTTP/1.1, but for the answer to what it cannot parse."""

    def send_400_response(self, msg: str) -> None:
        """Answer and hang up. No request exists yet, so no middleware sees this."""
        request_id = uuid.uuid4().hex
        answer = _PROBLEM.response(instance="", request_id=request_id)
        headers = [
            (b"content-type", PROBLEM_TYPE.encode()),
            (b"content-length", str(len(answer.body)).encode()),
            (b"x-content-type-options", b"nosniff"),
            (b"x-request-id", request_id.encode()),
            (b"connection", b"close"),
        ]
        events = (
            h11.Response(status_code=400, headers=headers, reason=b"Bad Request"),
            h11.Data(data=bytes(answer.body)),
            h11.EndOfMessage(),
        )
        for event in events:
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()
