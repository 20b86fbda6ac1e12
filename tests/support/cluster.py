"""Starts a scheduler, workers and servers of one cluster as local processes."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

from app.engine.certificates import make_certificates
from tests.support.api import Api
from tests.support.databases import environment_of
from tests.support.ports import reserved_port
from tests.support.processes import Process, children
from tests.support.servers import RunningServer, running_server, start, start_anew, stop
from tests.support.sources import CHECKOUT
from tests.support.waiting import until

PATIENCE_S = 60
_numbers = count(1)


@dataclass
class Node:
    """One process of the cluster, and its log file."""

    process: Process
    log: Path

    @property
    def log_text(self) -> str:
        return self.log.read_text("utf-8")

    def wait_for_log(self, words: str) -> None:
        with suppress(AssertionError):
            until(lambda: words in self.log_text or self.process.poll() is not None)
        assert words in self.log_text

    def kill(self) -> None:
        """Kill the process with SIGKILL, as the kernel does when memory runs out."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def wait_for_exit(self) -> int:
        return self.process.wait(PATIENCE_S)


@dataclass
class Cluster:
    """One cluster; all processes that it started are stopped when its block ends."""

    folder: Path
    port: int
    _started: ExitStack
    settings: dict[str, str] = field(default_factory=dict)
    anew: bool = False
    """Start Python itself for each process, as benchmarks do."""

    @property
    def data(self) -> Path:
        return self.folder / "data"

    @property
    def address(self) -> str:
        return f"tls://127.0.0.1:{self.port}"

    @property
    def certificates(self) -> Path:
        return self.folder / "certificates"

    def tls(self, node: str, folder: Path | None = None) -> dict[str, str]:
        folder = folder or self.certificates
        return {
            "UNGHOST_TLS_CA": str(folder / "ca.pem"),
            "UNGHOST_TLS_CERT": str(folder / f"{node}.pem"),
            "UNGHOST_TLS_KEY": str(folder / f"{node}.key"),
        }

    def scheduler(self) -> Node:
        words = ("unghost.cli", "scheduler", "--port", str(self.port))
        node = self.node(words, self.tls("scheduler"))
        assert node.process.stdout is not None
        assert str(self.port) in node.process.stdout.readline(), node.log_text
        return node

    def worker(
        self,
        *more: str,
        program: tuple[str, ...] = ("unghost.cli", "worker"),
        joined: bool = True,
        **settings: str,
    ) -> Node:
        chosen = {"UNGHOST_ENGINE": self.address, **self.tls("worker"), **settings}
        node = self.node((*program, *more), {"UNGHOST_WORKERS": "1", **chosen})
        if joined:
            node.wait_for_log("joined the scheduler")
        return node

    @contextmanager
    def server(self, **settings: str) -> Iterator[tuple[RunningServer, Api]]:
        engine = {"UNGHOST_ENGINE": self.address, **self.tls("client")}
        with running_server(
            self.data, {**engine, **self.settings, **settings}, anew=self.anew
        ) as server:
            api = Api.at(server.url, server.headers)
            with api.http:
                yield server, api

    def node(self, words: tuple[str, ...], settings: dict[str, str]) -> Node:
        log = self.folder / f"node-{next(_numbers)}.log"
        environ = {
            "PYTHONPATH": str(CHECKOUT),
            **environment_of(self.data),
            **self.settings,
            **settings,
        }
        if self.anew:
            command = [sys.executable, "-m", *words]
            process: Process = start_anew(command, self.data, log, environ)
        else:
            process = start(words, self.data, log, environ)
        self._started.callback(stop, process)
        return Node(process, log)


@contextmanager
def cluster(folder: Path, *, anew: bool = False) -> Iterator[Cluster]:
    """A cluster with certificates and a port, in which no process runs yet."""
    with reserved_port() as port, ExitStack() as started:
        made = Cluster(folder, port, started, anew=anew)
        make_certificates(made.certificates, ("127.0.0.1",), 2)
        yield made


def working_process(worker: Node) -> int:
    """Wait for the child process in which a worker computes, and return its id.

    The worker's own process only supervises it, and starts another one when it died.
    """

    def only_child() -> int | None:
        processes = children(worker.process.pid)
        return processes[0] if len(processes) == 1 else None

    return until(only_child, "no process works") or 0


def kill_working_process(worker: Node) -> int:
    """Kill the child process of a worker with SIGKILL, and return its id."""
    child = working_process(worker)
    os.kill(child, signal.SIGKILL)
    return child


def listening(*pids: int) -> set[tuple[str, int]]:
    """Addresses and ports on which processes listen."""
    lines = subprocess.run(
        ["ss", "-ltnpH"], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    addresses = set()
    for line in lines:
        owners = {int(pid) for pid in re.findall(r"pid=(\d+)", line)}
        if owners & set(pids):
            host, _, port = line.split()[3].rpartition(":")
            addresses.add((host, int(port)))
    return addresses
