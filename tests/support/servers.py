"""Starts the real service as a separate process, on a free port."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from tests.support import plain_http, processes
from tests.support.databases import environment_of, give_tables
from tests.support.processes import Process
from tests.support.waiting import until

STOP_WAIT_S = 30
SERVER = (sys.executable, "-m", "app")
"""The command that starts a server."""
SESSION_KEY = "unghost.session.v1"
"""The key under which the page stores its session in the browser."""


def wait_until_ready(url: str) -> httpx.Response:
    """Wait until a server is ready, and return its answer.

    On a busy machine it may not be for some seconds, as its event loop was late.
    """

    def ask() -> httpx.Response | None:
        response = plain_http.get(f"{url}/readyz")
        return response if response.is_success else None

    response = until(ask, lambda: plain_http.get(f"{url}/readyz").text)
    assert response is not None
    return response


@dataclass(frozen=True)
class RunningServer:
    """A server that answers requests, until the block that started it ends."""

    url: str
    token: str
    data: Path
    log: Path
    process: Process

    @property
    def login_link(self) -> str:
        """A new link to sign in with in a browser; each link works once."""
        return self.login_link_of(self.token)

    def login_link_of(self, token: str) -> str:
        """A new link to sign in with as the owner of this token."""
        headers = {"Authorization": f"Bearer {token}"}
        made = plain_http.post(f"{self.url}/api/v1/login-codes", headers=headers)
        assert made.status_code == 201, made.text
        return f"{self.url}/#code={made.json()['code']}"

    def signed_in(self, token: str = "") -> dict[str, Any]:
        """The browser storage of a signed-in user, as Playwright takes it."""
        body = {"token": token or self.token}
        opened = plain_http.post(f"{self.url}/api/v1/session", json=body)
        assert opened.status_code == 201, opened.text
        kept = {"name": SESSION_KEY, "value": opened.text}
        return {
            "cookies": [],
            "origins": [{"origin": self.url, "localStorage": [kept]}],
        }

    @property
    def headers(self) -> dict[str, str]:
        """The header that sends the data folder's first token."""
        return {"Authorization": f"Bearer {self.token}"}


StartServer = Callable[..., RunningServer]


@contextmanager
def running_server(
    data: Path, settings: Mapping[str, str] | None = None, *, anew: bool = False
) -> Iterator[RunningServer]:
    """Serve this data folder; `settings` are UNGHOST_* variables.

    `anew` starts a new Python interpreter, and lets the service make its database: for
    benchmarks and for tests of the start.

    Raises
    ------
    AssertionError
        The server ended before it was ready; the text is its log.
    """
    log = data.with_name(f"{data.name}.log")
    if anew:
        process = start_anew(SERVER, data, log, settings or {})
    else:
        give_tables(data, settings or {})
        process = start(["app"], data, log, settings or {})
    try:
        url = wait_for_link(process, log).partition("/#")[0]
        yield RunningServer(url, token_of(data), data, log, process)
    finally:
        stop(process)


def start(
    words: Sequence[str], data: Path, log: Path, settings: Mapping[str, str]
) -> Process:
    """Start ``python -m MODULE WORDS`` next to its data, with only these settings."""
    with log.open("a", encoding="utf-8") as errors:
        return processes.start(words, data.parent, environ_of(data, settings), errors)


def start_anew(
    command: Sequence[str], data: Path, log: Path, settings: Mapping[str, str]
) -> Process:
    """Start any command as `start` does, in a new Python interpreter."""
    environ = environ_of(data, settings)
    with log.open("a", encoding="utf-8") as errors:
        return processes.start_anew(command, data.parent, environ, errors)


def environ_of(data: Path, settings: Mapping[str, str]) -> dict[str, str]:
    """The environment of a process that uses this data folder."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith("UNGHOST_")}
    own = {"UNGHOST_DATA": str(data), "UNGHOST_PORT": "0"}
    state = {"XDG_STATE_HOME": str(data.with_name(f"{data.name}-state"))}
    return {**clean, **own, **environment_of(data), **state, **settings}


def wait_for_link(process: Process, log: Path) -> str:
    """Wait for the login link that the server prints when it is ready."""
    assert process.stdout is not None
    for line in process.stdout:
        if "/#code=" in line:
            return line.split()[-1]
    raise AssertionError(f"the server did not start:\n{log.read_text('utf-8')}")


def token_of(data: Path) -> str:
    """The first token of a data folder."""
    return (data / "token").read_text("utf-8").strip()


def stop(process: Process) -> None:
    """End the process as a service manager does: SIGTERM, then SIGKILL."""
    process.terminate()
    try:
        process.wait(STOP_WAIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
