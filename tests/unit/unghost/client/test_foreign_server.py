"""A token found on disk is not sent if another user's program has the port."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest

from unghost import Client, RetryPolicy
from unghost.cli.options import ServerOptions
from unghost.client.call import Call, nothing
from unghost.client.discovery import ForeignServer, IgnoredTokenFile, find_server
from unghost.client.duplex import Duplex
from unghost.client.transport import Transport
from unghost.wire.note import note_path

ME = 12345
OWNER = 1000
NOBODY = 65534
pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or os.geteuid() != 0,
    reason="needs Linux, and root to start programs of other users",
)
# Prints its port, then the Authorization header of each request on a line.
LISTENER = """
import http.server, socket, sys
class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        print(self.headers.get("Authorization"), flush=True)
        self.send_response(200)
        self.send_header("Content-Length", "2")
        self.end_headers()
        self.wfile.write(b"{}")
    def log_message(self, *_):
        pass
class Server(http.server.HTTPServer):
    address_family = getattr(socket, sys.argv[2])
server = Server((sys.argv[1], int(sys.argv[3])), Handler)
print(server.server_port, flush=True)
server.serve_forever()
"""


@dataclass(frozen=True)
class Listener:
    process: subprocess.Popen[str]
    port: int

    def heard(self) -> list[str]:
        """End the listener, and return the Authorization headers that it received."""
        self.process.kill()
        assert self.process.stdout is not None
        heard = self.process.stdout.read().split("\n")[:-1]
        self.process.wait()
        return heard


StartListener = Callable[..., Listener]


@pytest.fixture
def start_listener() -> Iterator[StartListener]:
    """A function that starts a listener as a user, by default on a free port."""
    started: list[subprocess.Popen[str]] = []

    def start(uid: int, host: str = "127.0.0.1", port: int = 0) -> Listener:
        family = "AF_INET6" if ":" in host else "AF_INET"
        process = subprocess.Popen(
            ["/usr/bin/env", "python3", "-c", LISTENER, host, family, str(port)],
            user=uid,
            cwd="/",
            # Other users may have no access to the interpreter that runs the tests.
            env={"PATH": "/usr/local/bin:/usr/bin:/bin"},
            stdout=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        assert process.stdout is not None
        return Listener(process, int(process.stdout.readline()))

    yield start
    for process in started:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


@pytest.fixture
def token_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The token file of a server of OWNER, the only token that can be found."""
    for name in ("UNGHOST_TOKEN", "UNGHOST_DATA", "UNGHOST_SERVER", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "data" / "token"
    file.parent.mkdir()
    file.write_text("secret\n")
    os.chown(file, OWNER, OWNER)
    return file


def write_note(url: str, token_file: Path) -> None:
    note = note_path(url, os.environ)
    note.parent.mkdir(parents=True, exist_ok=True)
    note.write_text(json.dumps({"url": url, "token_file": str(token_file), "pid": 1}))
    os.chown(note, OWNER, OWNER)


def open_transport(url: str, token: str | None = None) -> closing[Transport]:
    """The transport of a client of this server, with the token that it finds."""
    retry = RetryPolicy(for_s=0)
    return closing(Transport(find_server(url, token), timeout=60, retry=retry))


def send_request(url: str, token: str | None = None) -> None:
    with open_transport(url, token) as transport:
        transport.send(Call("GET", "/version", nothing))


@pytest.mark.parametrize(
    ("host", "name"),
    [
        *((host, "127.0.0.1") for host in ("127.0.0.1", "0.0.0.0", "::")),
        *((host, "localhost") for host in ("127.0.0.1", "::1")),
    ],
)
def test_found_token_is_not_sent_to_another_users_listener(
    token_file, start_listener, host, name
):
    other = start_listener(NOBODY, host)
    url = f"http://{name}:{other.port}"
    write_note(url, token_file)

    with pytest.raises(ForeignServer) as refused:
        send_request(url)

    text = str(refused.value)
    assert f"user {NOBODY} listens at {url}" in text
    assert f"{token_file} belongs to user {OWNER}" in text
    assert "UNGHOST_TOKEN" in text
    assert other.heard() == []


@pytest.mark.parametrize("folder", ["chosen by UNGHOST_DATA", "unghost-data"])
def test_token_found_in_data_folder_is_not_sent_to_another_user(
    token_file, start_listener, monkeypatch, folder
):
    monkeypatch.setattr(os, "geteuid", lambda: OWNER)
    token_file.parent.rename(token_file.parent.parent / folder)
    if folder != "unghost-data":
        monkeypatch.setenv("UNGHOST_DATA", folder)
    other = start_listener(NOBODY)

    with pytest.raises(ForeignServer):
        send_request(f"http://127.0.0.1:{other.port}")

    assert other.heard() == []


@pytest.mark.parametrize("uid", [OWNER, 0], ids=["its owner", "root"])
def test_found_token_is_sent_to_listener_of_its_owner_or_root(
    token_file, start_listener, uid
):
    own = start_listener(uid)
    url = f"http://127.0.0.1:{own.port}"
    write_note(url, token_file)

    send_request(url)

    assert own.heard() == ["Bearer secret"]


def test_explicit_token_is_sent_to_another_users_listener(
    token_file, start_listener, monkeypatch
):
    other = start_listener(NOBODY)
    url = f"http://127.0.0.1:{other.port}"
    write_note(url, token_file)

    send_request(url, "given")
    monkeypatch.setenv("UNGHOST_TOKEN", "of the environment")
    send_request(url)

    assert other.heard() == ["Bearer given", "Bearer of the environment"]


def test_nothing_is_sent_to_another_users_listener_without_a_token(
    token_file, start_listener
):
    token_file.unlink()
    other = start_listener(NOBODY)
    url = f"http://127.0.0.1:{other.port}"

    with pytest.raises(ForeignServer) as refused:
        send_request(url)

    assert f"user {NOBODY} listens at {url}" in str(refused.value)
    assert "UNGHOST_TOKEN" in str(refused.value)
    assert other.heard() == []


@pytest.mark.parametrize("uid", [OWNER, 0], ids=["oneself", "root"])
def test_request_without_a_token_is_sent_to_own_listener_or_one_of_root(
    token_file, start_listener, monkeypatch, uid
):
    token_file.unlink()
    monkeypatch.setattr(os, "geteuid", lambda: OWNER)
    own = start_listener(uid)

    send_request(f"http://127.0.0.1:{own.port}")

    assert own.heard() == ["None"]


@pytest.mark.parametrize("place", ["UNGHOST_DATA", "note", "unghost-data"])
def test_token_file_of_another_user_is_ignored(
    token_file, start_listener, monkeypatch, place
):
    own, other = start_listener(ME), start_listener(OWNER)
    monkeypatch.setattr(os, "geteuid", lambda: ME)
    if place == "UNGHOST_DATA":
        monkeypatch.setenv(place, str(token_file.parent))
    elif place == "unghost-data":
        token_file.parent.rename(place)
    for port in (own.port, other.port) if place == "note" else ():
        write_note(f"http://127.0.0.1:{port}", token_file)

    with pytest.warns(IgnoredTokenFile, match=f"token belongs to user {OWNER}"):
        send_request(f"http://127.0.0.1:{own.port}")
    with pytest.warns(IgnoredTokenFile), pytest.raises(ForeignServer):
        send_request(f"http://127.0.0.1:{other.port}")

    assert (own.heard(), other.heard()) == (["None"], [])


def test_root_uses_only_token_files_of_others_that_were_named(
    token_file, start_listener, monkeypatch
):
    own = start_listener(0)
    url = f"http://127.0.0.1:{own.port}"
    token_file.parent.rename("unghost-data")

    with pytest.warns(IgnoredTokenFile):
        send_request(url)
    monkeypatch.setenv("UNGHOST_DATA", "unghost-data")
    send_request(url)

    assert own.heard() == ["None", "Bearer secret"]


def test_command_notes_an_ignored_token_file(token_file, start_listener, capsys):
    own = start_listener(0)
    token_file.parent.rename("unghost-data")

    ServerOptions(server=f"http://127.0.0.1:{own.port}").connect().close()

    assert capsys.readouterr().err == (
        f"ignored: unghost-data/token belongs to user {OWNER}; if it is the token of "
        "your server, give it as UNGHOST_TOKEN\n"
    )


def test_token_file_that_is_a_pipe_is_ignored(token_file):
    os.mkfifo(token_file.with_name("pipe"))
    token_file.with_name("pipe").rename(token_file)
    token_file.parent.rename("unghost-data")

    assert find_server("http://127.0.0.1:1").token is None


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2"])
def test_token_is_found_if_no_foreign_program_listens_at_the_address(
    token_file, start_listener, host
):
    other = start_listener(NOBODY, host)
    if host == "127.0.0.1":
        other.heard()  # it has ended
    url = f"http://127.0.0.1:{other.port}"
    write_note(url, token_file)

    with Client(url) as client:
        assert client.token == "secret"


def test_listener_owner_is_checked_again_on_reconnect(token_file, start_listener):
    own = start_listener(OWNER)
    url = f"http://127.0.0.1:{own.port}"
    write_note(url, token_file)

    with open_transport(url) as transport:
        transport.send(Call("GET", "/version", nothing))
        assert own.heard() == ["Bearer secret"]
        other = start_listener(NOBODY, port=own.port)
        with pytest.raises(ForeignServer):
            transport.send(Call("GET", "/version", nothing))
        with pytest.raises(ForeignServer):
            Duplex(transport.endpoint("/")).begin("text/plain", 1)

    assert other.heard() == []
