"""A server that speaks S3, as a process of its own, and a gate in front of it.

What it stores is in its memory: a store that goes away and comes back with all that it
had is the gate, shut and opened again.
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

from app.addresses import Bucket
from app.storage.base import place_of
from app.storage.s3 import S3Place, retrying_client
from tests.support import plain_http
from tests.support.sources import CHECKOUT

KEYS = {"AWS_ACCESS_KEY_ID": "tests", "AWS_SECRET_ACCESS_KEY": "a-secret-of-tests"}
_CHUNK = 1 << 16


@dataclass(frozen=True)
class TestBucket:
    """A bucket that nobody else has, and how a service is told of it."""

    __test__ = False

    url: str
    name: str
    prefix: str = "some/where"
    more: Mapping[str, Any] = field(default_factory=dict)

    @property
    def settings(self) -> dict[str, Any]:
        """What `Settings` say of it."""
        return {
            "storage": f"s3://{self.name}/{self.prefix}",
            "storage_endpoint": self.url,
            **self.more,
        }

    @property
    def environment(self) -> dict[str, str]:
        """The same as variables of a process, and the keys."""
        own = {f"UNGHOST_{name.upper()}": str(v) for name, v in self.settings.items()}
        return {**own, **KEYS}

    def place(self, **more: Any) -> S3Place:
        """The same for a store that is opened by hand."""
        bucket = Bucket(self.name, self.prefix)
        chosen = {"region": None, "plain": True, "timeout_s": 20.0, **more}
        return S3Place(bucket, self.url, **chosen)

    def behind(self, url: str, **more: Any) -> TestBucket:
        """The same bucket, asked at another address."""
        return replace(self, url=url, more=more)

    def keys(self) -> list[str]:
        """What lies in it, with the prefix, past the service."""
        found = [one["path"] for some in self._client.list() for one in some]
        return sorted(f"{self.prefix}/{path}" for path in found)

    def blobs(self) -> list[str]:
        """Digests of what the service has put."""
        names = [key.rpartition("/")[2] for key in self.keys()]
        return [name for name in names if len(name) == 64]

    def overwrite(self, digest: str, content: bytes) -> None:
        """Damage a blob."""
        self._client.put(place_of(digest), content)

    def delete(self, digest: str) -> None:
        """Lose a blob."""
        self._client.delete(place_of(digest))

    @cached_property
    def _client(self) -> S3Store:
        return retrying_client(self.place())


@dataclass(frozen=True)
class S3Server:
    """The server; anybody may make buckets in it."""

    url: str
    process: subprocess.Popen[str]

    @contextmanager
    def at_another_time(self, offset_s: float) -> Iterator[None]:
        """What is put meanwhile was put so much later, or earlier, as it says."""
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
        """A new one."""
        name = f"tests-{uuid.uuid4().hex}"
        plain_http.put(f"{self.url}/{name}").raise_for_status()
        return TestBucket(self.url, name)


@contextmanager
def s3_server() -> Iterator[S3Server]:
    """A server on a free port; it ends with us, however we end."""
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
    """Serve until the standard input ends; each line of it shifts the clock."""
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
    """Lets connections through to a server, or not.

    Shut, it refuses them and cuts those that there are; held, it takes them and is
    silent.
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
        """Its address, the same whenever it is open."""
        return f"http://127.0.0.1:{self.port}"

    def open(self) -> None:
        """Let connections through from now on."""
        if self._listener is not None:
            return
        listener = socket.create_server(("127.0.0.1", self.port), backlog=128)
        self.port = listener.getsockname()[1]
        self._listener = listener
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()

    def hold(self) -> None:
        """Pass on nothing, until it flows again."""
        self._flowing.clear()

    def flow(self) -> None:
        """Pass on what was held, and all that comes."""
        self._flowing.set()

    def shut(self) -> None:
        """Refuse new connections, and cut those that there are in the middle."""
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


def _end(one: socket.socket) -> None:
    with suppress(OSError):
        one.shutdown(socket.SHUT_RDWR)
    one.close()


@contextmanager
def gate(url: str) -> Iterator[Gate]:
    """A gate in front of a server, open at first."""
    made = Gate(url)
    try:
        yield made
    finally:
        made.shut()
        made.flow()


Answer = Callable[[Mapping[str, str]], tuple[int, str]]
"""What a server says to the headers of a request: a status, and a document."""


@contextmanager
def answering(say: Answer) -> Iterator[str]:
    """The address of a server that answers every request in one way."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def answer(self) -> None:
            """One request."""
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
            """Nothing."""

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
