"""A worker: joins a scheduler and processes chunks until it is stopped.

It consists of two processes: one works, the other restarts it when it has died.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from argparse import ArgumentParser
from dataclasses import dataclass, field
from types import FrameType
from typing import TYPE_CHECKING, Final

from sqlalchemy.exc import SQLAlchemyError

from app.addresses import LOCAL_ENGINE, EngineAddress
from app.context import ServiceContext
from app.db.transient import in_a_line, is_transient
from app.engine.children import ending_text
from app.engine.chunk import UnusableEngine
from app.engine.cluster import work_with
from app.engine.dask import (
    NOWHERE,
    close_dashboard,
    prepare,
    reason_of,
    scratch_folder,
    security,
    stop_event,
)
from app.jobs.work import work_in_worker
from app.logs import configure_logging, server_log
from app.maintenance.datafolder import CannotMaintain
from app.memory import keep_freed_memory, settle
from app.process.lifespan import attached, certificates_of
from app.settings import Settings
from filter_core.processes import module_command

if TYPE_CHECKING:
    from distributed import Security

REFUSED: Final = 1
"""Exit status of a worker process whose settings cannot be used."""
AWAY: Final = 74
"""Exit status: it could not connect to the scheduler or to the database."""
LOST: Final = 75
"""Exit status: the connection to the scheduler was lost; a new process reconnects."""
_SHORT_LIFE_S: Final = 10.0
_PAUSE_S: Final = 0.25
_LONGEST_PAUSE_S: Final = 8.0
_IDLE_POLL_S: Final = 0.05
_STDIN: Final = 0
_KEEP_MEMORY: Final = {
    # As `keep_freed_memory`, from the first allocation on.
    "MALLOC_TRIM_THRESHOLD_": "268435456",
    "MALLOC_MMAP_THRESHOLD_": "268435456",
    "MALLOC_TOP_PAD_": "16777216",
}


@dataclass(frozen=True)
class WorkerEndpoint:
    """Where a worker listens, and how long it waits for its scheduler."""

    host: str | None = None
    port: int = 0
    patience_s: float = 60.0


@dataclass
class Supervisor:
    """Starts a worker process, and restarts it whenever it dies."""

    settings: Settings
    endpoint: WorkerEndpoint
    program: str = "app.process.worker"
    _child: subprocess.Popen[bytes] | None = None
    _stopping: threading.Event = field(default_factory=threading.Event)

    def run(self) -> int:
        """Run until stopped or failed; the exit status is 0, `REFUSED` or `AWAY`."""
        check_engine(self.settings)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        with scratch_folder() as scratch:
            return self._keep_working(scratch)

    def _keep_working(self, scratch: str) -> int:
        pause = _PAUSE_S
        while not self._stopping.is_set():
            begun = time.monotonic()
            status = self._work(scratch)
            if self._stopping.is_set():
                # -SIGTERM: the child had not installed its handler yet.
                return 0 if status in (0, LOST, -signal.SIGTERM) else REFUSED
            if status in (REFUSED, AWAY):
                return status
            if status != LOST:
                server_log.warning(
                    "a worker process %s; starting another", ending_text(status)
                )
            is_old = time.monotonic() - begun > _SHORT_LIFE_S
            pause = _PAUSE_S if is_old else min(2 * pause, _LONGEST_PAUSE_S)
            self._stopping.wait(pause)
        return 0

    def _work(self, scratch: str) -> int:
        endpoint = self.endpoint
        words = [f"--port={endpoint.port}", f"--patience={endpoint.patience_s}"]
        words += [f"--host={endpoint.host}"] if endpoint.host else []
        settings = self.settings
        chosen = {
            f"UNGHOST_{name.upper()}": str(getattr(settings, name))
            for name in settings.model_fields_set
            if isinstance(getattr(settings, name), str | int | float | os.PathLike)
        }
        own = {**_KEEP_MEMORY, "DASK_TEMPORARY_DIRECTORY": scratch}
        # When this process ends, the pipe is closed, and the child ends as well.
        self._child = subprocess.Popen(
            module_command(self.program, *words),
            env={**os.environ, **own, **chosen},
            stdin=subprocess.PIPE,
        )
        if self._stopping.is_set():
            self._child.terminate()
        with self._child:
            return self._child.wait()

    def _stop(self, _number: int, _frame: FrameType | None) -> None:
        child = self._child
        if child is not None and child.poll() is None:
            # A second signal kills it: another worker processes its chunks again.
            child.send_signal(
                signal.SIGKILL if self._stopping.is_set() else signal.SIGTERM
            )
        self._stopping.set()


def check_engine(settings: Settings) -> EngineAddress:
    """The address of the scheduler, after checking the settings for joining it.

    Raises UnusableEngine: the settings name no scheduler, or its certificates cannot be
    used.
    """
    if settings.engine == LOCAL_ENGINE:
        raise UnusableEngine(
            "a worker needs a scheduler: set UNGHOST_ENGINE=tls://HOST:8786"
        )
    address = EngineAddress.parse(settings.engine)
    prepare()
    security(certificates_of(settings), encrypted=address.is_encrypted)
    return address


class Work:
    """Processes the chunks that the scheduler sends, and counts those in progress."""

    def __init__(self, services: ServiceContext) -> None:
        self._services = services
        self._counting = threading.Lock()
        self.running = 0

    def __call__(self, kind: str, job_id: int, number: int, installation: str) -> str:
        """Process a chunk."""
        with self._counting:
            self.running += 1
        try:
            place = kind, job_id, number
            return work_in_worker(self._services, place, installation)
        finally:
            with self._counting:
                self.running -= 1


def work(settings: Settings, endpoint: WorkerEndpoint) -> int:
    """Join, and work until stopped or disconnected; returns the exit status."""
    address = check_engine(settings)
    with attached(settings) as services:
        settle()
        mine = Work(services)
        work_with(mine)
        return asyncio.run(_join(services, mine, address, endpoint))


def work_when_database_answers(settings: Settings, endpoint: WorkerEndpoint) -> int:
    """As `work`; waits up to `patience_s` for a database that does not respond."""
    until, has_warned = time.monotonic() + endpoint.patience_s, False
    while True:
        try:
            return work(settings, endpoint)
        except SQLAlchemyError as exc:
            if not is_transient(exc):
                raise
            if time.monotonic() > until:
                server_log.error("the database does not respond: %s", in_a_line(exc))
                return AWAY
            if not has_warned:
                server_log.warning("waiting for the database: %s", in_a_line(exc))
                has_warned = True
        time.sleep(_PAUSE_S)


async def _join(
    services: ServiceContext,
    mine: Work,
    address: EngineAddress,
    endpoint: WorkerEndpoint,
) -> int:
    from distributed import Worker

    stop, loop = stop_event(), asyncio.get_running_loop()

    def wait_for_parent() -> None:
        while os.read(_STDIN, 1024):
            pass
        loop.call_soon_threadsafe(stop.set)

    threading.Thread(target=wait_for_parent, daemon=True).start()
    shown = security(certificates_of(services.settings), encrypted=address.is_encrypted)
    if not await _is_reachable(address, shown, endpoint.patience_s):
        return AWAY
    worker = Worker(
        str(address),
        host=endpoint.host or _own_address(address),
        port=endpoint.port,
        protocol=f"{address.scheme}://",
        security=shown,
        nthreads=1,  # a chunk uses all threads of the engine here
        memory_limit=0,
        dashboard=False,
        dashboard_address=NOWHERE,
        death_timeout=endpoint.patience_s,
        validate=False,
    )
    try:
        await worker
    except RuntimeError as exc:
        raise UnusableEngine(f"this worker cannot start: {reason_of(exc)}") from exc
    close_dashboard(worker)
    server_log.info("joined the scheduler at %s as %s", address, worker.address)
    ends = [asyncio.create_task(stop.wait()), asyncio.create_task(worker.finished())]
    await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
    if not stop.is_set():
        server_log.warning("lost the connection to the scheduler at %s", address)
        return LOST
    services.engine.stopping.set()
    while mine.running:
        await asyncio.sleep(_IDLE_POLL_S)
    await worker.close(nanny=False)
    server_log.info("stopped")
    return 0


async def _is_reachable(
    address: EngineAddress, shown: Security, patience_s: float
) -> bool:
    from distributed.core import connect

    try:
        comm = await connect(
            str(address), timeout=patience_s, **shown.get_connection_args("worker")
        )
    except OSError as exc:
        server_log.error(
            "cannot connect to the scheduler at %s: %s", address, reason_of(exc)
        )
        return False
    await comm.close()
    return True


def _own_address(address: EngineAddress) -> str:
    """The address of this machine in the scheduler's network, to listen on."""
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as way:
        way.connect((address.host, address.port or 1))
        return str(way.getsockname()[0])


def main() -> int:
    """The worker process; its settings are UNGHOST_* variables."""
    parser = ArgumentParser(prog="app.process.worker")
    parser.add_argument("--host")
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--patience", type=float, default=60.0)
    options = parser.parse_args()
    settings = Settings()
    configure_logging(settings.log_level, settings.log_format)
    keep_freed_memory()
    try:
        return work_when_database_answers(
            settings, WorkerEndpoint(options.host, options.port, options.patience)
        )
    except (UnusableEngine, CannotMaintain) as exc:
        server_log.error("%s", exc)
        return REFUSED


if __name__ == "__main__":
    sys.exit(main())
