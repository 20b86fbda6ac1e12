"""Where the server is, and the token of a server on this machine.

A token that was found in a file is only ever given to a server on this machine: it
opens that server and is no business of any other.
"""

from __future__ import annotations

import ipaddress
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import httpx

DEFAULT_URL: Final = "http://127.0.0.1:8000"
DEFAULT_DATA: Final = Path("unghost-data")
_DEFAULT_PORT: Final = {"http": 80, "https": 443}


@dataclass(frozen=True)
class Server:
    """A server's address, and the token to show there (None: none was found)."""

    url: str
    token: str | None


class BadServerUrl(ValueError):
    """An address that is not http://HOST[:PORT] or https://HOST[:PORT]."""


def find_server(
    url: str | None = None,
    token: str | None = None,
    *,
    environ: Mapping[str, str] | None = None,
) -> Server:
    """The server to talk to, from what was said, the environment and local files.

    The token is the first of: the one given, `UNGHOST_TOKEN`, the `token` file in the
    folder `UNGHOST_DATA`, what `unghost serve` noted for just this address, the `token`
    file in `./unghost-data`.
    """
    env = os.environ if environ is None else environ
    address = _checked(url or env.get("UNGHOST_SERVER") or DEFAULT_URL)
    said = token or env.get("UNGHOST_TOKEN")
    return Server(address, said.strip() if said else _local_token(address, env))


def server_note(url: str, environ: Mapping[str, str] | None = None) -> Path:
    """The file in which `unghost serve` notes its token file, one per address."""
    env = os.environ if environ is None else environ
    parsed = httpx.URL(url)
    port = parsed.port or _DEFAULT_PORT[parsed.scheme]
    state = env.get("XDG_STATE_HOME") or Path(_home(env), ".local", "state")
    host = "127.0.0.1" if parsed.host == "localhost" else parsed.host
    return Path(state, "unghost", "servers", f"{host}_{port}.json")


def _home(env: Mapping[str, str]) -> Path:
    home = env.get("HOME")
    return Path(home) if home else Path.home()


def _checked(url: str) -> str:
    try:
        parsed = httpx.URL(url)
    except httpx.InvalidURL as exc:
        raise BadServerUrl(f"{url!r} is not the address of a server: {exc}") from exc
    if parsed.scheme not in _DEFAULT_PORT or not parsed.host:
        raise BadServerUrl(
            f"{url!r} is not the address of a server, such as {DEFAULT_URL}"
        )
    return url.rstrip("/")


def _local_token(url: str, env: Mapping[str, str]) -> str | None:
    if not is_local(httpx.URL(url).host):
        return None
    said = env.get("UNGHOST_DATA")
    files = [
        Path(said, "token") if said else None,
        _noted_token_file(server_note(url, env)),
        # Only a guess: the server may have been started with another folder.
        DEFAULT_DATA / "token",
    ]
    tokens = (_read(file) for file in files if file is not None)
    return next((token for token in tokens if token), None)


def is_local(host: str) -> bool:
    """Whether a host name or address is this machine itself."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _noted_token_file(note: Path) -> Path | None:
    text = _read(note)
    try:
        noted = json.loads(text) if text else None
    except ValueError:
        return None
    file = noted.get("token_file") if isinstance(noted, dict) else None
    return Path(file) if isinstance(file, str) else None


def _read(file: Path) -> str | None:
    # Absent, or another person's: then it is not for us.
    try:
        return file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError):
        return None
