"""A server that receives hooks: it keeps each request, and responds as it is told."""

import base64
import hashlib
import hmac
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any, NamedTuple

from tests.support.waiting import until


class Received(NamedTuple):
    """One request: its headers and its body."""

    headers: dict[str, str]
    body: bytes

    @property
    def content(self) -> Any:
        return json.loads(self.body)

    def is_signed_with(self, secret: str) -> bool:
        """Whether the signature is that of Standard Webhooks, computed anew."""
        key = base64.b64decode(secret.removeprefix("whsec_"))
        names = ("webhook-id", "webhook-timestamp")
        signed = b".".join(
            [*(self.headers[name].encode() for name in names), self.body]
        )
        digest = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest())
        return self.headers["webhook-signature"] == f"v1,{digest.decode()}"


class Receiver:
    """What has arrived at `url`; `statuses` are those of the next responses (200),
    which wait for `may_respond`."""

    def __init__(self, port: int) -> None:
        self.url = f"http://127.0.0.1:{port}/hook"
        self.statuses: list[int] = []
        self.received: list[Received] = []
        self.may_respond = threading.Event()
        self.may_respond.set()

    def wait_for(self, number: int) -> list[Received]:
        """All requests, once there are so many."""
        until(lambda: len(self.received) >= number, f"{self.received}")
        return self.received


@contextmanager
def receiving() -> Iterator[Receiver]:
    """Receive hooks on a free port until the block ends."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            status = receiver.statuses.pop(0) if receiver.statuses else 200
            headers = {name.lower(): value for name, value in self.headers.items()}
            receiver.received.append(Received(headers, body))
            receiver.may_respond.wait()
            self.send_response(status)
            if status == 302:
                self.send_header("Location", receiver.url)
            self.send_header("Content-Length", "0")
            with suppress(OSError):  # the sender has left
                self.end_headers()

        def log_message(self, *_: object) -> None:
            """Print nothing."""

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        receiver = Receiver(server.server_port)
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield receiver
        finally:
            server.shutdown()
            thread.join()
