"""The real service as a process of its own, on a port that the system picks."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.databases import environment_of

STOP_WAIT_S = 30


@dataclass(frozen=True)
class RunningServer:
    """A server that answers requests, until the block that started it ends."""

    url: str
    token: str
    data: Path
    log: Path
    process: subprocess.Popen[str]

    @property
    def login_link(self) -> str:
        """What a person would open."""
        return f"{self.url}/#token={self.token}"

    @property
    def headers(self) -> dict[str, str]:
        """What a program shows to be let in."""
        return {"Authorization": f"Bearer {self.token}"}


@contextmanager
def running_server(
    data: Path, settings: Mapping[str, str] | None = None
) -> Iterator[RunningServer]:
    """Serve this data folder; `settings` are UNGHOST_* variables.

    Raises
    ------
    AssertionError
        The server ended before it was ready; the text is its log.
    """
    log = data.with_name(f"{data.name}.log")
    process = start([sys.executable, "-m", "app"], data, log, settings or {})
    try:
        url, token = wait_for_link(process, log)
        yield RunningServer(url, token, data, log, process)
    finally:
        stop(process)


def start(
    command: list[str],
    data: Path,
    log: Path,
    settings: Mapping[str, str],
    *,
    stdin: int = subprocess.DEVNULL,
) -> subprocess.Popen[str]:
    """The process, beside its data, with nothing of the developer's own settings."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith("UNGHOST_")}
    own = {"UNGHOST_DATA": str(data), "UNGHOST_PORT": "0"}
    state = {"XDG_STATE_HOME": str(data.with_name(f"{data.name}-state"))}
    with log.open("a", encoding="utf-8") as stderr:
        return subprocess.Popen(
            command,
            cwd=data.parent,
            env={**clean, **own, **environment_of(data), **state, **settings},
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        )


def wait_for_link(process: subprocess.Popen[str], log: Path) -> tuple[str, str]:
    """Address and token, from the line that the server prints when it is ready."""
    assert process.stdout is not None
    for line in process.stdout:
        url, found, token = line.strip().partition("/#token=")
        if found:
            return url.split()[-1], token
    raise AssertionError(f"the server did not start:\n{log.read_text('utf-8')}")


def stop(process: subprocess.Popen[str]) -> None:
    """End it as a service manager would: politely, then not."""
    process.terminate()
    try:
        process.wait(STOP_WAIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
