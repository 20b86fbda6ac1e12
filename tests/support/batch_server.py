"""A small HTTP server that accepts batches, and fails where a test wants it to."""

import io
import json
import tarfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

COUNTS = {"kept": 1, "rejected": 2, "unmeasured": 3}
FRAME = {
    "id": 7,
    "key": "a",
    "dataset": "town",
    "created_at": "2026-01-01T00:00:00Z",
    "counts": {"boxes": 6, **COUNTS, "reviewed": 0, "to_review": 5},
}


@dataclass(frozen=True)
class BatchReply:
    """How the server answers one batch; by default as the real service does.

    `lines`: close the connection after so many lines. `refusal`: refuse the batch with
    this status, code and headers. `decisions`: the counts that each line reports.
    `end`: keys of the last line besides ``end``.
    """

    lines: int | None = None
    refusal: tuple[int, str, dict[str, str]] | None = None
    decisions: object = field(default_factory=lambda: COUNTS)
    end: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ReceivedFrame:
    """A frame that was received."""

    key: str
    annotation: dict[str, Any]
    files: dict[str, bytes]


class BatchServer:
    """Records every frame that it receives; `replies` say how batches are answered.

    `known` maps the keys of frames that it already has to their digests. It closes the
    connection, without an answer, on the first `dropped_requests` requests for known
    frames. Frames in `others_answered`, sent one by one, are refused with 403, because
    other people have answered their boxes.
    """

    def __init__(self) -> None:
        self.replies: list[BatchReply] = []
        self.taken: list[ReceivedFrame] = []
        self.put: list[str] = []
        self.heads: list[tuple[str, dict[str, str]]] = []
        self.known: dict[str, str] = {}
        self.asked_about: list[list[str]] = []
        self.dropped_requests = 0
        self.others_answered: set[str] = set()
        self._http = _Http(("127.0.0.1", 0), self._handler())
        self.url = f"http://127.0.0.1:{self._http.server_port}"
        self._thread = threading.Thread(target=self._http.serve_forever, args=(0.01,))
        self._thread.start()

    def close(self) -> None:
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()

    @property
    def keys(self) -> list[str]:
        return [frame.key for frame in self.taken]

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        server = self

        class Handler(_Handler):
            owner = server

        return Handler


class _Http(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, *_: object) -> None:
        """Print no traceback: some tests make the client disconnect."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    owner: BatchServer

    def do_POST(self) -> None:
        path, _, _ = self.path.partition("?")
        if path.endswith("/known-frames"):
            self._tell_known()
        else:
            self.owner.heads.append((self.path, dict(self.headers.items())))
            self._take(
                self.owner.replies.pop(0) if self.owner.replies else BatchReply()
            )

    def do_PUT(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        self.owner.put.append(self.path)
        if self.path.rpartition("/")[2].partition("?")[0] in self.owner.others_answered:
            refusal = {"status": 403, "code": "others_answers", "detail": "by others"}
            self._answer(403, refusal, {})
        else:
            self._answer(201, {"frame": FRAME}, {})

    def handle_expect_100(self) -> bool:
        turn = self.owner.replies[0] if self.owner.replies else BatchReply()
        return True if turn.refusal else super().handle_expect_100()

    def _tell_known(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        if self.owner.dropped_requests:
            self.owner.dropped_requests -= 1
            self.close_connection = True
            return
        self.owner.asked_about.append(body["keys"])
        digests = self.owner.known
        items = [
            {"key": key, "frame_id": 7, "digest": digests[key]}
            for key in body["keys"]
            if key in digests
        ]
        self._answer(200, {"items": items}, {})

    def _take(self, turn: BatchReply) -> None:
        if turn.refusal is not None:
            status, code, headers = turn.refusal
            self.close_connection = True
            self._answer(status, {"status": status, "code": code}, headers)
            return
        self.send_response(200)
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        body = io.BytesIO(self.rfile.read(int(self.headers["Content-Length"])))
        for number, frame in enumerate(_frames(body)):
            if number == turn.lines:
                self.close_connection = True
                return
            self.owner.taken.append(frame)
            line = {"key": frame.key, "status": 201, "frame_id": number}
            self._line({**line, "decisions": turn.decisions})
        self._line({"end": True, **turn.end})
        self.wfile.write(b"0\r\n\r\n")

    def _line(self, line: dict[str, Any]) -> None:
        content = json.dumps(line).encode() + b"\n"
        self.wfile.write(b"%x\r\n%s\r\n" % (len(content), content))

    def _answer(self, status: int, body: object, headers: dict[str, str]) -> None:
        content = json.dumps(body).encode()
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_args: object) -> None:
        pass


def _frames(body: io.BytesIO) -> Iterator[ReceivedFrame]:
    frame: ReceivedFrame | None = None
    with tarfile.open(fileobj=body, mode="r|") as archive:
        for member in archive:
            opened = archive.extractfile(member)
            assert opened is not None
            name, _, kind = member.name.partition(".")
            if kind == "json":
                if frame is not None:
                    yield frame
                annotation = json.loads(opened.read())
                frame = ReceivedFrame(annotation.pop("key", name), annotation, {})
            else:
                assert frame is not None
                frame.files[kind] = opened.read()
    if frame is not None:
        yield frame
