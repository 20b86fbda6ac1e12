"""How the client finds the server's address and its token, in a fixed order."""

import json
from pathlib import Path

import pytest

from unghost import find_server
from unghost.client.discovery import BadServerUrl
from unghost.wire.note import note_path

LOCAL = "http://127.0.0.1:8000"


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty home folder that is also the current folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def env_of(home: Path, **more: str) -> dict[str, str]:
    return {"HOME": str(home), **more}


def write_token(folder: Path, token: str) -> Path:
    folder.mkdir(parents=True)
    file = folder / "token"
    file.write_text(token + "\n")
    return file


def note(home: Path, url: str, token_file: Path) -> None:
    file = note_path(url, env_of(home))
    file.parent.mkdir(parents=True)
    file.write_text(json.dumps({"url": url, "token_file": str(token_file), "pid": 1}))


def test_default_is_localhost_without_token(home):
    server = find_server(environ=env_of(home))

    assert (server.url, server.token) == (LOCAL, None)
    file = note_path(LOCAL, env_of(home))
    file.parent.mkdir(parents=True)
    file.write_text("{half a no")

    assert find_server(environ=env_of(home)).token is None


def test_arguments_override_environment_variables(home):
    environ = env_of(home, UNGHOST_SERVER="http://a:1", UNGHOST_TOKEN="env")

    said = find_server("http://b:2/", "mine", environ=environ)
    from_environ = find_server(environ=environ)

    assert (said.url, said.token) == ("http://b:2", "mine")
    assert (from_environ.url, from_environ.token) == ("http://a:1", "env")


def test_token_lookup_order_is_unghost_data_then_note_then_default(home):
    write_token(home / "unghost-data", "guess")
    assert find_server(environ=env_of(home)).token == "guess"

    note(home, LOCAL, write_token(home / "elsewhere", "noted"))
    assert find_server(environ=env_of(home)).token == "noted"

    write_token(home / "chosen", "chosen")
    chosen = env_of(home, UNGHOST_DATA=str(home / "chosen"))
    assert find_server(environ=chosen).token == "chosen"


def test_note_applies_only_to_its_host_and_port(home):
    note(home, "http://127.0.0.1:9000", write_token(home / "elsewhere", "noted"))

    assert find_server("http://127.0.0.1:9000", environ=env_of(home)).token == "noted"
    assert find_server("http://127.0.0.1:9001", environ=env_of(home)).token is None
    environ = env_of(home, XDG_STATE_HOME=str(home / "state"))

    expected = home / "state" / "unghost" / "servers" / "127.0.0.1_8000.json"
    assert note_path(LOCAL, environ) == expected


@pytest.mark.parametrize(
    ("noted", "host"),
    [
        ("localhost", "localhost"),
        ("localhost", "127.0.0.1"),
        ("[::1]", "[::1]"),
        ("[::1]", "[0:0:0:0:0:0:0:1]"),
        ("[0:0:0:0:0:0:0:1]", "[::1]"),
    ],
)
def test_note_applies_to_every_form_of_its_address(home, noted, host):
    note(home, f"http://{noted}:9000", write_token(home / "elsewhere", "noted"))

    server = find_server(f"http://{host}:9000", environ=env_of(home))

    assert server.token == "noted"


@pytest.mark.parametrize(
    ("host", "token"),
    [
        *((host, "guess") for host in ("localhost", "127.0.0.1", "127.9.9.9", "[::1]")),
        ("labels.example", None),
    ],
)
def test_local_token_is_used_for_loopback_addresses_only(home, host, token):
    write_token(home / "unghost-data", "guess")

    assert find_server(f"http://{host}:8000", environ=env_of(home)).token == token


@pytest.mark.parametrize("url", ["127.0.0.1:8000", "ftp://a", "http://", "http://a:x"])
def test_invalid_server_url_raises_bad_server_url(home, url):
    with pytest.raises(BadServerUrl, match="not the address of a server"):
        find_server(url, environ=env_of(home))
    with pytest.raises(BadServerUrl, match=f"^UNGHOST_SERVER: {url!r} is not the ad"):
        find_server(environ=env_of(home, UNGHOST_SERVER=url))
