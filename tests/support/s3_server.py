"""An S3 server as a process of its own, and a gate that cuts the connection to it.

The server keeps everything in its memory. To let a store go away and come back with
all of its objects, shut the gate in front of it and open it again.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from functools import cached_property
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from obstore.store import S3Store

from app.storage.base import place_of
from app.storage.s3 import S3Place, retrying_client
from tests.support import plain_http
from tests.support.sources import CHECKOUT

KEYS = {"AWS_ACCESS_KEY_ID": "tests", "AWS_SECRET_ACCESS_KEY": "a-secret-of-tests"}
_CHUNK = 1 << 16


@dataclass(frozen=True)
class TestBucket:
    """A bucket that only one test uses, and the settings that name it."""

    __test__ = False

    url: str
    name: str
    prefix: str = "some/where"
    more: Mapping[str, Any] = field(default_factory=dict)

    @property
    def settings(self) -> dict[str, Any]:
        """The keys of `Settings` that name this bucket."""
        return {
            "storage": f"s3://{self.name}/{self.prefix}",
            "storage_endpoint": self.url,
            **self.more,
        }

    @property
    def environment(self) -> dict[str, str]:
        """The same as environment variables, with the access keys."""
        own = {f"UNGHOST_{name.upper()}": str(v) for name, v in self.settings.items()}
        return {**own, **KEYS}

    def place(self, **more: Any) -> S3Place:
        """The bucket as an `S3Place`, to open a store without a service."""
        chosen = {"region": None, "plain": True, "timeout_s": 20.0, **more}
        return S3Place(self.name, self.prefix, self.url, **chosen)

    def behind(self, url: str, **more: Any) -> TestBucket:
        """The same bucket through another address, such as a gate's."""
        return replace(self, url=url, more=more)

    def keys(self) -> list[str]:
        """The keys of all objects in it, with the prefix, past the service."""
        paths = [file["path"] for some in self._client.list() for file in some]
        return sorted(f"{self.prefix}/{path}" for path in paths)

    def blobs(self) -> list[str]:
        """The digests of the files that the service has stored."""
        names = [key.rpartition("/")[2] for key in self.keys()]
        return [name for name in names if len(name) == 64]

    def overwrite(self, digest: str, content: bytes) -> None:
        """Replace the content of a stored file, past the service."""
        self._client.put(place_of(digest), content)

    def delete(self, digest: str) -> None:
        """Delete a stored file, past the service."""
        self._client.delete(place_of(digest))

    @cached_property
    def _client(self) -> S3Store:
        return retrying_client(self.place())


@dataclass(frozen=True)
class S3Server:
    """The running server, in which tests make buckets."""

    url: str
    process: subprocess.Popen[str]

    @contextmanager
    def at_another_time(self, offset_s: float) -> Iterator[None]:
        """Shift the server's clock during the block; objects get the shifted time."""
        self._set_clock(offset_s)
        try:
            yield
        finally:
            self._set_clock(0.0)

    def _set_clock(self, offset_s: float) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{offset_s}\n")
        self.process.stdin.flush()
        assert float(self.process.stdout.readline()) == offset_s

    def bucket(self) -> TestBucket:
        """Create a new bucket."""
        name = f"tests-{uuid.uuid4().hex}"
        plain_http.put(f"{self.url}/{name}").raise_for_status()
        return TestBucket(self.url, name)


@contextmanager
def s3_server() -> Iterator[S3Server]:
    """Start a server on a free port; it ends with this process in any case."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.support.s3_server"],
        cwd=CHECKOUT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        yield S3Server(process.stdout.readline().strip(), process)
    finally:
        process.stdin.close()
        process.stdout.close()
        process.wait(30)


def main() -> None:
    """Serve until standard input ends; each line of it is an offset of the clock."""
    from moto.core.utils import utcnow
    from moto.s3 import models
    from moto.server import ThreadedMotoServer

    offset_s = 0.0

    def shifted_now() -> datetime:
        now: datetime = utcnow() + timedelta(seconds=offset_s)
        return now

    vars(models)["utcnow"] = shifted_now
    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    _say(f"http://{host}:{port}")
    for line in sys.stdin:
        offset_s = float(line)
        _say(line.strip())
    server.stop()


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


class Gate:
    """A proxy in front of a server that can be shut or held.

    Shut, it refuses new connections and cuts those that are open. Held, it accepts
    connections but passes nothing on.
    """

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._to = (parts.hostname or "", parts.port or 0)
        self._flowing = threading.Event()
        self._flowing.set()
        self._open: set[socket.socket] = set()
        self._lock = threading.Lock()
        self._listener: socket.socket | None = None
        self.port = 0
        self.open()

    @property
    def url(self) -> str:
        """The gate's address, which stays the same after it was shut."""
        return f"http://127.0.0.1:{self.port}"

    def open(self) -> None:
        """Accept connections from now on."""
        if self._listener is not None:
            return
        listener = socket.create_server(("127.0.0.1", self.port), backlog=128)
        self.port = listener.getsockname()[1]
        self._listener = listener
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()

    def hold(self) -> None:
        """Pass nothing on until `flow` is called."""
        self._flowing.clear()

    def flow(self) -> None:
        """Pass on what was held, and everything that follows."""
        self._flowing.set()

    def shut(self) -> None:
        """Refuse new connections, and cut the open ones."""
        listener, self._listener = self._listener, None
        if listener is None:
            return
        _end(listener)
        with self._lock:
            ended, self._open = self._open, set()
        for end in ended:
            _end(end)

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                near, _ = listener.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(self._to)
            except OSError:
                _end(near)
                continue
            with self._lock:
                self._open |= {near, far}
            if self._listener is not listener:
                _end(near)
                _end(far)
                continue
            for source, target in ((near, far), (far, near)):
                threading.Thread(
                    target=self._pass_on, args=(source, target), daemon=True
                ).start()

    def _pass_on(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(_CHUNK):
                self._flowing.wait()
                target.sendall(data)
        for end in (source, target):
            with self._lock:
                self._open.discard(end)
            _end(end)


def _end(connection: socket.socket) -> None:
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
    connection.close()


@contextmanager
def gate(url: str) -> Iterator[Gate]:
    """Yield an open gate in front of a server; it is shut at the end."""
    made = Gate(url)
    try:
        yield made
    finally:
        made.shut()
        made.flow()


Answer = Callable[[Mapping[str, str]], tuple[int, str]]
"""A function from a request's headers to a status and a document."""


@contextmanager
def server_answering_with(say: Answer) -> Iterator[str]:
    """Start a server that answers every request with `say`; yields its address."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def answer(self) -> None:
            """Answer one request of any method."""
            self.rfile.read(int(self.headers.get("content-length") or 0))
            status, text = say(dict(self.headers))
            body = b"" if self.command == "HEAD" else text.encode()
            self.send_response(status)
            self.send_header("Content-Type", "application/xml")
            self.send_header("Content-Length", str(len(body)))
            self.send_header("ETag", '"any"')
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            """Print no log."""

    for method in ("GET", "HEAD", "PUT", "POST", "DELETE"):
        setattr(Handler, f"do_{method}", Handler.answer)
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()


if __name__ == "__main__":
    main()
