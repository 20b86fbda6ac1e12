"""The path of the note with which commands find a server on this machine.

The note has the server's address and the path of its token file. The service writes it,
and commands read it. This module needs neither pydantic nor httpx.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

DEFAULT_PORT: Final = {"http": 80, "https": 443}
"""The default port of each scheme."""


def note_path(url: str, environ: Mapping[str, str]) -> Path:
    """The path of a server's note, which need not exist: one per host and port.

    `url` is such as http://127.0.0.1:8000. The names of one address share a note:
    `localhost` is 127.0.0.1, and IPv6 is shortened. `XDG_STATE_HOME` and `HOME` are
    read. Raises ValueError if the port is no number.
    """
    parts = urlsplit(url)
    port = parts.port or DEFAULT_PORT[parts.scheme]
    name = f"{_shortest(parts.hostname or '')}_{port}.json"
    return state_folder(environ) / "servers" / name


def state_folder(environ: Mapping[str, str]) -> Path:
    """The folder in which commands of one user share state."""
    home = environ.get("HOME")
    state = environ.get("XDG_STATE_HOME")
    return Path(state or Path(home or Path.home(), ".local", "state")) / "unghost"


def _shortest(host: str) -> str:
    if host == "localhost":
        return "127.0.0.1"
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        return host
