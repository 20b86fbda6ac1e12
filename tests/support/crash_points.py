"""Servers that kill themselves (SIGKILL) at a point that a test chooses.

A point is before or after a step that stores or confirms data, such as a flush of a
file or a commit. The service knows nothing of this: run as a program, this module
wraps the functions that the service calls in such steps, and serves.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.api import Api
from tests.support.poison import lay_poison
from tests.support.processes import Process
from tests.support.servers import start, stop, token_of, wait_for_link
from tests.support.sources import CHECKOUT

POINTS = ("draft", "flush_file", "rename", "flush_folder", "commit", "answer")
TIME_LIMIT_S = 60
ARMED = "armed"
"""The server counts towards its point while a file of this name is beside its data."""


@dataclass(frozen=True)
class Point:
    """The moment to die: before or after the `turn`-th step of this name."""

    name: str
    after: bool
    turn: int = 1

    def __str__(self) -> str:
        return f"{'after' if self.after else 'before'}-{self.name}-{self.turn}"


@dataclass
class CrashingServers:
    """Starts servers of one data folder, one after the other."""

    data: Path
    _living: Process | None = None

    def server(self, point: Point | None = None) -> tuple[str, str]:
        """Start a server that dies at a point after `arm`; its address and token."""
        (self.data.with_name(ARMED)).unlink(missing_ok=True)
        return self._link({"point": None if point is None else vars(point)})

    def start_poisoned(self, kind: str) -> tuple[str, str]:
        """Start a server that dies of a kind of poison; its address and token."""
        return self._link({"poison": kind})

    def start_and_wait_for_crash(self, kind: str) -> int:
        """Start a poisoned server that dies without any request; its exit status."""
        self._start({"poison": kind})
        return self.wait_for_exit(ask=False)

    def arm(self) -> None:
        """From now on, let the server count the steps towards its point."""
        self.data.with_name(ARMED).touch()

    def wait_for_exit(self, *, ask: bool) -> int:
        """Wait for the server's end; its exit status. `ask` sends SIGTERM first."""
        process, self._living = self._living, None
        assert process is not None
        with process:
            if ask:
                process.terminate()
            try:
                return process.wait(TIME_LIMIT_S)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGABRT)
                return process.wait()

    def end(self) -> None:
        """Stop the server that a failed test has left running."""
        if self._living is not None:
            stop(self._living)

    def _start(self, word: dict[str, Any]) -> Process:
        settings = {"PYTHONPATH": str(CHECKOUT), "UNGHOST_WORKERS": "1"}
        words = ["tests.support.crash_points", json.dumps(word)]
        self._living = start(words, self.data, self._log, settings)
        return self._living

    def _link(self, word: dict[str, Any]) -> tuple[str, str]:
        link = wait_for_link(self._start(word), self._log)
        return link.partition("/#")[0], token_of(self.data)

    @property
    def _log(self) -> Path:
        return self.data.with_name("crash.log")


Link = tuple[str, str]
"""The address of a server, and a token of an admin."""


@contextmanager
def client_of(link: Link) -> Iterator[Api]:
    url, token = link
    api = Api.at(url, {"Authorization": f"Bearer {token}"})
    with api.http:
        yield api


@contextmanager
def running_client(servers: CrashingServers, link: Link | None = None) -> Iterator[Api]:
    """A client of a server that is terminated after the block and must exit with 0."""
    with client_of(link or servers.server()) as api:
        yield api
    assert servers.wait_for_exit(ask=True) == 0


@contextmanager
def crashing_servers(data: Path) -> Iterator[CrashingServers]:
    """Yield a `CrashingServers` of a data folder; stop its last server at the end."""
    made = CrashingServers(data)
    try:
        yield made
    finally:
        made.end()


class CrashCounter:
    """Counts the steps of one kind, and kills this process at the chosen one."""

    def __init__(self, point: Point, armed: Path) -> None:
        self._point, self._armed, self._seen = point, armed, 0

    def note_step(self, name: str, *, after: bool) -> None:
        """Note that a step begins or, with `after`, has ended; die if it is the one."""
        if (name, after) != (self._point.name, self._point.after):
            return
        if not self._armed.exists():
            return
        self._seen += 1
        if self._seen == self._point.turn:
            os.kill(os.getpid(), signal.SIGKILL)
            time.sleep(60)  # so that nothing more happens before the signal arrives


def wrapped(
    counter: CrashCounter, call: Callable[..., Any], name_of: Callable[..., str]
) -> Any:
    """Wrap a function so that its calls are counted; `name_of` names the step."""

    def counted(*args: Any, **more: Any) -> Any:
        name = name_of(*args)
        counter.note_step(name, after=False)
        result = call(*args, **more)
        counter.note_step(name, after=True)
        return result

    return counted


def wrap_calls(counter: CrashCounter) -> None:
    """Wrap every call that makes data durable, and the sending of responses."""
    from sqlalchemy.engine.default import DefaultDialect
    from uvicorn.protocols.http.httptools_impl import RequestResponseCycle

    def of_flush(descriptor: int) -> str:
        path = str(Path(f"/proc/self/fd/{descriptor}").readlink())
        if "/blobs" not in path:
            return ""
        return "flush_file" if "/.new-" in path else "flush_folder"

    def of_open(path: Any, *_: Any) -> str:
        return "draft" if "/.new-" in str(path) else ""

    def of_rename(old: Any, _new: Any) -> str:
        return "rename" if "/.new-" in str(old) else ""

    send = RequestResponseCycle.send

    async def sending(cycle: Any, message: Any) -> None:
        name = "answer" if message["type"] == "http.response.body" else ""
        counter.note_step(name, after=False)
        await send(cycle, message)
        counter.note_step(name, after=True)

    commit = wrapped(counter, DefaultDialect.do_commit, lambda *_: "commit")
    for owner, name, call in (
        (os, "fsync", wrapped(counter, os.fsync, of_flush)),
        (os, "open", wrapped(counter, os.open, of_open)),
        (os, "replace", wrapped(counter, os.replace, of_rename)),
        (DefaultDialect, "do_commit", commit),
        (RequestResponseCycle, "send", sending),
    ):
        setattr(owner, name, call)


def become_server(point: Point | None, poison: str | None) -> None:
    """Serve in this process, with the point or the poison prepared."""
    from app.serve import serve
    from app.settings import Settings

    settings = Settings()
    if poison is not None:
        lay_poison(poison)
    if point is not None:
        wrap_calls(CrashCounter(point, settings.data.with_name(ARMED)))
    serve(settings)


if __name__ == "__main__":
    told = json.loads(sys.argv[1])
    become_server(
        Point(**told["point"]) if told.get("point") else None, told.get("poison")
    )
