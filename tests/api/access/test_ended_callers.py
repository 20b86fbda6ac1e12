"""Callers whose token or session ends while their request is still arriving.

Nothing that arrives afterwards is stored, although the head of the request was sent
with a valid secret.
"""

import json
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from itertools import count
from urllib.parse import urlsplit

import httpx
import pytest

from tests.support import frames as scene
from tests.support import plain_http
from tests.support.api import BASE
from tests.support.archives import Connection, frame, tar_without_end
from tests.support.connections import open_connection, read_until_closed, request_head
from tests.support.servers import RunningServer

_numbers = count()


@dataclass(frozen=True)
class Caller:
    """A token of a test's own."""

    id: int
    token: str

    @property
    def bearer(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"}


@pytest.fixture
def new_caller(api):
    def caller(role):
        name = f"leaving-{next(_numbers)}"
        made = api.post("/tokens", {"name": name, "role": role}).json()
        return Caller(made["id"], made["token"])

    return caller


@contextmanager
def open_request(
    server: RunningServer, method: str, path: str, body: bytes, **headers: str
) -> Iterator[socket.socket]:
    """A request whose head the server has accepted; its body is not sent yet."""
    place = urlsplit(server.url)
    headers |= {"Host": place.netloc, "Content-Length": str(len(body))}
    headers |= {"Connection": "close", "Expect": "100-continue"}
    with open_connection(server.url) as connection:
        connection.sendall(request_head(method, f"{BASE}{path}", headers))
        # The server asks for the body after it has checked the caller.
        assert connection.recv(4096).startswith(b"HTTP/1.1 100 ")
        yield connection


def answer_to(connection: socket.socket, body: bytes) -> tuple[int, str]:
    """Send the body; returns the status and the code of the refusal."""
    connection.sendall(body)
    head, _, content = read_until_closed(connection).partition(b"\r\n\r\n")
    return int(head.split()[1]), json.loads(content).get("code", "")


JSON = {"Content-Type": "application/json"}


@pytest.mark.parametrize("more", [{}, {"Idempotency-Key": "a"}])
def test_revoked_admin_cannot_finish_the_request_for_a_new_token(
    api, server, new_caller, more
):
    leaving = new_caller("admin")
    name = f"heir-{leaving.id}"
    body = json.dumps({"name": name, "role": "admin"}).encode()

    with open_request(
        server, "POST", "/tokens", body, **JSON, **leaving.bearer, **more
    ) as connection:
        api.delete(f"/tokens/{leaving.id}")
        refused = answer_to(connection, body)

    assert refused == (401, "token_revoked")
    names = {item["name"] for item in api.json("/tokens", limit=1000)["items"]}
    assert name not in names


@pytest.mark.parametrize("code", ["token_revoked", "session_expired"])
def test_answer_that_arrives_after_its_caller_has_ended_is_not_stored(
    api, server, new_caller, ghosts, code
):
    leaving = new_caller("reviewer")
    opened = api.post("/session", {"token": leaving.token}).json()["session"]
    session = {"Authorization": f"Bearer {opened}"}
    bearer = leaving.bearer if code == "token_revoked" else session
    path = f"/boxes/{ghosts[0]}/reviews"
    body = json.dumps({"verdict": "keep", "seen_revision": 0}).encode()

    with open_request(server, "POST", path, body, **JSON, **bearer) as connection:
        if code == "token_revoked":
            api.delete(f"/tokens/{leaving.id}")
        else:
            plain_http.delete(f"{server.url}{BASE}/session", headers=session)
        refused = answer_to(connection, body)

    assert refused == (401, code)
    assert api.json(f"/boxes/{ghosts[0]}")["review"] is None


def test_frame_that_arrives_after_the_token_was_revoked_is_not_stored(
    api, server, new_caller
):
    leaving, dataset = new_caller("reviewer"), api.dataset()
    form = httpx.Request(
        "PUT",
        server.url,
        files={
            "annotation": json.dumps(scene.annotation()),
            "segmentation": scene.segmentation(),
        },
    )
    body, kind = form.read(), {"Content-Type": form.headers["content-type"]}
    path = f"/datasets/{dataset}/frames/late"

    with open_request(
        server, "PUT", path, body, **kind, **leaving.bearer
    ) as connection:
        api.delete(f"/tokens/{leaving.id}")
        refused = answer_to(connection, body)

    assert refused == (401, "token_revoked")
    assert api.json(f"/datasets/{dataset}/frames")["items"] == []
    assert api.json(f"/datasets/{dataset}/problems")["items"] == []


def test_open_batch_ends_at_the_first_frame_after_its_token_was_revoked(
    api, server, new_caller
):
    leaving, dataset = new_caller("reviewer"), api.dataset()
    caller = replace(server, token=leaving.token)

    with closing(Connection(caller, dataset)) as batch:
        batch.send(tar_without_end(frame("0")))
        batch.send(tar_without_end(frame("1")))
        stored = batch.line()
        api.delete(f"/tokens/{leaving.id}")
        # In one piece, since the server may close the connection after the first frame.
        rest = [member for number in (2, 3, 4) for member in frame(f"{number}")]
        batch.send(tar_without_end(rest))
        end = batch.line()

    assert (stored["key"], stored["status"]) == ("run/0", 201)
    assert (end["end"], end["stored"], end["refused"]) == (True, 1, 0)
    assert end["problem"]["code"] == "token_revoked"
    frames = api.json(f"/datasets/{dataset}/frames")["items"]
    assert [item["key"] for item in frames] == ["run/0"]
