"""Starts a PostgreSQL server of its own, for one test or for a run of all tests.

``python -m tests.support.postgres_cluster COMMAND ...`` runs a command with a server:
UNGHOST_TEST_SERVER (`tests/support/databases.py`) names it. If the server that the
variable names already answers, it is used. Otherwise, where PostgreSQL is installed, a
new one is started, and stopped when the command ends.
"""

import os
import pwd
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.pool import NullPool

from tests.support import databases
from tests.support.ports import reserved_port
from tests.support.processes import children
from tools.ensure_programs import path_of

START_WAIT_S = 60
NOT_INSTALLED = "PostgreSQL's initdb is not installed here"
SETTINGS = """
listen_addresses = '127.0.0.1'
unix_socket_directories = ''
max_connections = 200
"""


@dataclass(frozen=True)
class Cluster:
    """A PostgreSQL server on a local port; `url` names one of its databases."""

    folder: Path
    programs: Path
    port: int

    @property
    def url(self) -> str:
        return f"postgresql+psycopg://postgres@127.0.0.1:{self.port}/postgres"

    def start(self) -> None:
        log = str(self.folder / "log")
        self._control("start", "-l", log, "-t", str(START_WAIT_S))

    def stop(self, mode: str = "immediate") -> None:
        """Stop the server; by default at once, without writing anything more."""
        self._control("stop", "-m", mode)

    def kill(self) -> None:
        """Kill the server's first process and its children with SIGKILL."""
        pid = int((self.folder / "data" / "postmaster.pid").read_text().split()[0])
        group = [pid, *children(pid)]
        for each in group:
            os.kill(each, signal.SIGKILL)

    def kill_backends(self, sig: signal.Signals = signal.SIGKILL) -> int:
        """Signal the server's processes for `unghost` connections; how many."""
        engine = create_engine(self.url, poolclass=NullPool)
        others = (
            "SELECT pid FROM pg_stat_activity WHERE application_name = 'unghost' "
            "AND backend_type = 'client backend'"
        )
        with engine.connect() as connection:
            pids = list(connection.execute(text(others)).scalars())
        for pid in pids:
            # Once one is killed, the server ends the others by itself.
            with suppress(ProcessLookupError):
                os.kill(pid, sig)
        return len(pids)

    def end_a_transaction(self) -> int:
        """End one `unghost` connection that is not idle; 0 if all are."""
        engine = create_engine(self.url, poolclass=NullPool)
        ended = (
            "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
            "WHERE application_name = 'unghost' AND state <> 'idle' LIMIT 1"
        )
        with engine.connect() as connection:
            return len(connection.execute(text(ended)).all())

    def _control(self, *words: str) -> None:
        run(self.programs / "pg_ctl", "-w", "-D", str(self.folder / "data"), *words)


@contextmanager
def own_cluster() -> Iterator[Cluster]:
    """Start a server until the block ends; skips where PostgreSQL is not installed."""
    programs = _programs()
    if programs is None:
        # In continuous integration it must be installed.
        assert not os.environ.get("CI"), NOT_INSTALLED
        pytest.skip(NOT_INSTALLED)
    folder = Path(tempfile.mkdtemp(prefix="unghost-cluster-"))
    try:
        if os.geteuid() == 0:
            shutil.chown(folder, "postgres", "postgres")
        data = folder / "data"
        trust = ("--auth=trust", "--username=postgres", "--no-sync")
        run(programs / "initdb", "-D", str(data), "--encoding=UTF8", *trust)
        with reserved_port() as port:
            with (data / "postgresql.conf").open("a") as file:
                file.write(f"{SETTINGS}port = {port}\n")
            cluster = Cluster(folder, programs, port)
            try:
                cluster.start()
                yield cluster
            finally:
                if (data / "postmaster.pid").exists():
                    cluster.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def run(program: Path, *words: str) -> None:
    """Run a program of PostgreSQL; not as root, which the server refuses."""
    done = subprocess.run(
        [program, *words],
        user="postgres" if os.geteuid() == 0 else None,
        cwd="/",
        env={**os.environ, "LC_ALL": "C"},
        # A pipe would stay open for as long as the server that is started runs.
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        timeout=2 * START_WAIT_S,
        check=False,
    )
    assert done.returncode == 0, f"{program.name} {words} failed"


def main(*command: str) -> int:
    """Run the command with a server that answers; returns its exit status."""
    has_server = databases.is_reachable() or _programs() is None
    for ends in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ends, lambda number, _: sys.exit(128 + number))
    with nullcontext() if has_server else own_cluster() as cluster:
        own = {databases.SERVER_VARIABLE: cluster.url} if cluster else {}
        process = subprocess.Popen(command, env={**os.environ, **own})
        # Ctrl-C in a terminal reaches the command as well: wait until it has ended.
        signal.signal(signal.SIGINT, lambda *_: None)
        for ends in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(ends, lambda number, _: process.send_signal(number))
        return process.wait()


def _programs() -> Path | None:
    """The folder of PostgreSQL's programs; None where they cannot be run."""
    initdb = path_of("initdb")
    return Path(initdb).parent if initdb and _may_be_run() else None


def _may_be_run() -> bool:
    if os.geteuid() != 0:
        return True
    try:
        return bool(pwd.getpwnam("postgres"))
    except KeyError:
        return False


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
