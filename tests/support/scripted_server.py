"""A real HTTP server on a free port that gives the answers that a test sets."""

import json
import threading
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from unghost import RetryPolicy

QUICK_RETRIES = RetryPolicy(base_s=0.001, longest_s=0.01)
"""Of a client that gets its answer after some failures."""

SHORT_RETRIES = RetryPolicy(for_s=0.1, base_s=0.001, longest_s=0.01)
"""Of a client whose server stays away."""


@dataclass(frozen=True)
class Reply:
    """One answer; `hang_up` closes the connection after that many bytes of it."""

    status: int = 200
    body: bytes = b"{}"
    headers: dict[str, str] = field(default_factory=dict)
    hang_up: int | None = None


@dataclass(frozen=True)
class ReceivedRequest:
    """One request as it arrived."""

    method: str
    path: str
    headers: dict[str, str]
    body: bytes


def json_reply(body: object, status: int = 200, **headers: str) -> Reply:
    return Reply(status, json.dumps(body).encode(), headers)


def problem(status: int, code: str, **more: object) -> Reply:
    body = {"status": status, "code": code, "detail": f"it is {code}", **more}
    return json_reply(body, status)


class ScriptedServer:
    """Answers requests with `replies` in turn; has them in `received_requests`."""

    def __init__(self) -> None:
        self.replies: list[Reply] = []
        self.fallback = Reply(501)
        self.received_requests: list[ReceivedRequest] = []
        self._http = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self.url = f"http://127.0.0.1:{self._http.server_port}"
        self._thread = threading.Thread(target=self._http.serve_forever, args=(0.01,))
        self._thread.start()

    def close(self) -> None:
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()

    def answer(self, *replies: Reply) -> None:
        self.replies.extend(replies)

    def answer_always(self, reply: Reply) -> None:
        """Answer all requests that have no reply of their own with this one."""
        self.fallback = reply

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        server = self

        class Handler(BaseHTTPRequestHandler):
            def handle_one_request(self) -> None:
                self.raw_requestline = self.rfile.readline()
                if self.raw_requestline and self.parse_request():
                    self._reply()
                self.close_connection = True

            def _reply(self) -> None:
                body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
                headers = dict(self.headers.items())
                server.received_requests.append(
                    ReceivedRequest(self.command, self.path, headers, body)
                )
                reply = server.replies.pop(0) if server.replies else server.fallback
                self.send_response(reply.status)
                for name, value in reply.headers.items():
                    self.send_header(name.replace("_", "-"), value)
                self.send_header("Content-Length", str(len(reply.body)))
                self.send_header("Connection", "close")
                self.end_headers()
                self.wfile.write(reply.body[: reply.hang_up])

            def log_message(self, *_args: object) -> None:
                pass

        return Handler
