"""HTTP by a parser in C; what is not HTTP is answered with a problem as well."""

from __future__ import annotations

import uuid
from typing import Final

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from app.http_errors import PROBLEM_TYPE, Problem
from app.logs import Answered, known_as, log_answer

_PROBLEM: Final = Problem(
    400, "malformed_http", "this is no request in HTTP/1.1 with a known method"
)


class ProblemProtocol(HttpToolsProtocol):
    """Uvicorn's HTTP/1.1, but for the answer to what it cannot parse."""

    def send_400_response(self, msg: str) -> None:
        """Answer and hang up. No request exists yet, so no middleware sees this."""
        request_id = uuid.uuid4().hex
        answer = _PROBLEM.response(instance="", request_id=request_id)
        client = self.client[0] if self.client else None
        with known_as(request_id):
            log_answer(Answered("-", "-", None, _PROBLEM.status, 0.0, None, client))
        head = (
            "HTTP/1.1 400 Bad Request",
            f"content-type: {PROBLEM_TYPE}",
            f"content-length: {len(answer.body)}",
            "x-content-type-options: nosniff",
            f"x-request-id: {request_id}",
            "connection: close",
        )
        self.transport.write("\r\n".join((*head, "", "")).encode())
        self.transport.write(bytes(answer.body))
        self.transport.close()
