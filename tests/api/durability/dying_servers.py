"""Servers that die, as by a power cut, at a named point of their work.

Only this module knows of the points: it wraps what the server calls, in processes of
its own. Run as a program it has loaded everything, and forks a server for every line
that it reads: a second start costs almost nothing.
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

from tests.poison import lay_poison
from tests.servers import start, stop, token_of

POINTS = ("draft", "flush_file", "rename", "flush_folder", "commit", "answer")
LIVES_AT_MOST_S = 60
ARMED = "armed"
"""A file of this name beside the data folder: from now on the point counts."""


@dataclass(frozen=True)
class Point:
    """Before or after the so-manieth call of its kind."""

    name: str
    after: bool
    turn: int = 1

    def __str__(self) -> str:
        return f"{'after' if self.after else 'before'}-{self.name}-{self.turn}"


@dataclass(frozen=True)
class Nursery:
    """The program that forks servers of one data folder."""

    process: subprocess.Popen[str]
    data: Path

    def server(self, point: Point | None = None) -> tuple[str, str]:
        """Address and token of a server that dies at a point, once it is armed."""
        (self.data.with_name(ARMED)).unlink(missing_ok=True)
        self._say({"point": None if point is None else vars(point)})
        return self._link()

    def poisoned(self, kind: str) -> tuple[str, str]:
        """The same of a server that dies of poison, at the latest when it is asked."""
        self._say({"poison": kind})
        return self._link()

    def dies(self, kind: str) -> int:
        """The exit status of a server that dies of poison before anybody asks it."""
        self._say({"poison": kind})
        return self.ended(ask=False)

    def arm(self) -> None:
        """From now on the point counts."""
        self.data.with_name(ARMED).touch()

    def ended(self, *, ask: bool) -> int:
        """Wait for the end of the server, asked for or not; its exit status."""
        self._say({"stop": ask})
        return int(self._hear("ended ").rpartition(" ")[2])

    def _link(self) -> tuple[str, str]:
        link = self._hear("/#code=").split()[-1]
        return link.partition("/#")[0], token_of(self.data)

    def _say(self, word: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(word) + "\n")
        self.process.stdin.flush()

    def _hear(self, word: str) -> str:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if word in line:
                return line.strip()
        raise AssertionError("the servers' program ended")


@contextmanager
def nursery(data: Path) -> Iterator[Nursery]:
    """A program that forks servers of this data folder."""
    log = data.with_name("dying.log")
    command = [sys.executable, "-m", "tests.api.durability.dying_servers"]
    checkout = Path(__file__).resolve().parents[3]
    settings = {"PYTHONPATH": str(checkout), "UNGHOST_WORKERS": "1"}
    process = start(command, data, log, settings, stdin=subprocess.PIPE)
    try:
        yield Nursery(process, data)
    finally:
        assert process.stdin is not None
        process.stdin.close()
        stop(process)


class Fuse:
    """Counts the calls of one kind, and ends the process at one of them."""

    def __init__(self, point: Point, armed: Path) -> None:
        self._point, self._armed, self._seen = point, armed, 0

    def pass_by(self, name: str, *, after: bool) -> None:
        """One call begins, or has returned."""
        if (name, after) != (self._point.name, self._point.after):
            return
        if not self._armed.exists():
            return
        self._seen += 1
        if self._seen == self._point.turn:
            os.kill(os.getpid(), signal.SIGKILL)
            time.sleep(60)  # until the signal is there, nothing more happens


def wrapped(fuse: Fuse, call: Callable[..., Any], name_of: Callable[..., str]) -> Any:
    """The call, with the fuse before and after it where it has a name."""

    def passing(*args: Any, **more: Any) -> Any:
        name = name_of(*args)
        fuse.pass_by(name, after=False)
        result = call(*args, **more)
        fuse.pass_by(name, after=True)
        return result

    return passing


def lay(fuse: Fuse) -> None:
    """Put the fuse around everything that makes an answer true, and around answers."""
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
        fuse.pass_by(name, after=False)
        await send(cycle, message)
        fuse.pass_by(name, after=True)

    commit = wrapped(fuse, DefaultDialect.do_commit, lambda *_: "commit")
    for owner, name, call in (
        (os, "fsync", wrapped(fuse, os.fsync, of_flush)),
        (os, "open", wrapped(fuse, os.open, of_open)),
        (os, "replace", wrapped(fuse, os.replace, of_rename)),
        (DefaultDialect, "do_commit", commit),
        (RequestResponseCycle, "send", sending),
    ):
        setattr(owner, name, call)


def grow_up(point: Point | None, poison: str | None) -> None:
    """Become a server."""
    from app.serve import serve
    from app.settings import Settings

    settings = Settings()
    if poison is not None:
        lay_poison(poison)
    if point is not None:
        lay(Fuse(point, settings.data.with_name(ARMED)))
    serve(settings)


def main() -> None:
    """Fork a server for every line; tell how it ended."""
    import app.main  # noqa: F401  # loaded once, for all servers

    child = 0
    for line in sys.stdin:
        word = json.loads(line)
        if "stop" in word:
            if word["stop"]:
                os.kill(child, signal.SIGTERM)
            tell_the_end(child)
            child = 0
            continue
        child = os.fork()
        if child == 0:
            point = word.get("point")
            grow_up(Point(**point) if point else None, word.get("poison"))
            os._exit(0)
    if child:  # the test failed before it was asked to end
        os.kill(child, signal.SIGKILL)


def tell_the_end(child: int) -> None:
    """Wait for a server; one that lives on after all is ended by force."""
    until = time.monotonic() + LIVES_AT_MOST_S
    done, status = os.waitpid(child, os.WNOHANG)
    while not done and time.monotonic() < until:
        time.sleep(0.01)
        done, status = os.waitpid(child, os.WNOHANG)
    if not done:
        os.kill(child, signal.SIGABRT)
        _, status = os.waitpid(child, 0)
    sys.stdout.write(f"ended {os.waitstatus_to_exitcode(status)}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
