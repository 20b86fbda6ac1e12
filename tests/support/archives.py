"""Makes tar archives of frames, and sends them as batches, also piece by piece."""

import io
import json
import tarfile
from collections.abc import Iterable, Mapping
from typing import Any
from urllib.parse import urlsplit

from tests.support import frames as scene
from tests.support.api import BASE
from tests.support.connections import open_connection, request_head
from tests.support.servers import RunningServer

Members = list[tuple[str, bytes]]
END = bytes(1024)


def frame(name: str, *, number: int = 0, **changed: Any) -> Members:
    """The members of one frame; `changed` are keys of its annotation."""
    annotation = {**scene.annotation(), "key": f"run/{name}", **changed}
    return [
        (f"{name}.json", json.dumps(annotation).encode()),
        (f"{name}.image.png", scene.image(number)),
        (f"{name}.segmentation.png", scene.segmentation()),
    ]


def tar_archive(
    members: Iterable[tuple[str, bytes]], form: int = tarfile.USTAR_FORMAT
) -> bytes:
    """An archive written by Python's tarfile."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=form) as archive:
        for name, content in members:
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return out.getvalue()


def tar_without_end(members: Members) -> bytes:
    """These members as an archive without the blocks that end it."""
    return b"".join(
        header_of(name, len(content)) + content + bytes(-len(content) % 512)
        for name, content in members
    )


def header_of(name: str, size: int, kind: bytes = tarfile.REGTYPE) -> bytes:
    """The header of a member, without its content."""
    member = tarfile.TarInfo(name)
    member.size, member.type = size, kind
    return member.tobuf(tarfile.GNU_FORMAT)


def lines_of(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


class Connection:
    """One batch request over a socket, sent and read piece by piece."""

    def __init__(self, server: RunningServer, dataset: str) -> None:
        place = urlsplit(server.url)
        headers: Mapping[str, str] = {
            "Host": place.netloc,
            "Content-Type": "application/x-tar",
            "Transfer-Encoding": "chunked",
            "Connection": "close",
            **server.headers,
        }
        self.socket = open_connection(server.url)
        path = f"/api/v1/datasets/{dataset}/batches"
        self.socket.sendall(request_head("POST", path, headers))
        self._answer = self.socket.makefile("rb")

    def send(self, data: bytes) -> None:
        self.socket.sendall(b"%x\r\n%b\r\n" % (len(data), data))

    def end(self) -> None:
        self.socket.sendall(b"0\r\n\r\n")

    def line(self) -> dict[str, Any]:
        """The next line of the response, which is one HTTP chunk."""
        for text in self._answer:
            if text.startswith(b"{"):
                line: dict[str, Any] = json.loads(text)
                return line
        raise AssertionError("the answer is over")

    def close(self) -> None:
        self._answer.close()
        self.socket.close()


TAR = {"Content-Type": "application/x-tar"}


def send(api, dataset, content, headers=TAR, **parameters):
    path = f"{BASE}/datasets/{dataset}/batches"
    return api.http.post(path, content=content, headers=headers, params=parameters)


def batch_results(response):
    assert response.status_code == 200, response.text
    *lines, end = lines_of(response.text)
    return [(line["key"], line["status"]) for line in lines], end
