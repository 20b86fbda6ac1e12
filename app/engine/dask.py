"""Dask: its scheduler, its configuration, and the certificates of its nodes."""

from __future__ import annotations

import asyncio
import logging
import signal
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final, NamedTuple

from app.addresses import EngineAddress, is_loopback
from app.engine.chunk import UnusableEngine

if TYPE_CHECKING:
    from distributed import Security
    from distributed.node import ServerNode

NOWHERE: Final = "127.0.0.1:0"
"""Address of Dask's dashboards, which are stopped right after the start."""


def run_scheduler(
    host: str, port: int, certificates: Certificates, ready: Callable[[str], None]
) -> None:
    """Run a scheduler until SIGTERM or SIGINT; `ready` gets its address.

    Raises UnusableEngine if it would be open to anybody, or cannot listen on that
    address.
    """
    encrypted = any(certificates)
    if not encrypted and not is_loopback(host):
        raise UnusableEngine(
            f"a scheduler at {host} without certificates would let anybody run code on "
            "every worker; give --ca, --cert and --key (`unghost certificates`)"
        )
    prepare()
    address = EngineAddress("tls" if encrypted else "tcp", host, port)

    async def serve(folder: str) -> None:
        from distributed import Scheduler

        scheduler = Scheduler(
            host=address.host,
            port=address.port,
            protocol=f"{address.scheme}://",
            security=security(certificates, encrypted=address.is_encrypted),
            dashboard=False,
            dashboard_address=NOWHERE,
            local_directory=folder,
        )
        try:
            await scheduler
        except (OSError, RuntimeError) as exc:
            detail = f"cannot listen at {address}: {reason_of(exc)}"
            raise UnusableEngine(detail) from exc
        close_dashboard(scheduler)
        stop = stop_event()
        ready(str(scheduler.address))
        await stop.wait()
        await scheduler.close()

    with scratch_folder() as folder:
        asyncio.run(serve(folder))


def scratch_folder() -> TemporaryDirectory[str]:
    """A new folder for the files of one node, removed at the end of a `with` block.

    Every node searches its own folder first for Python modules. By default, this folder
    is made in `dask-scratch-space`, where another user of the machine may have put
    files.
    """
    return TemporaryDirectory(prefix="unghost-", ignore_cleanup_errors=True)


def close_dashboard(node: ServerNode) -> None:
    """Stop the HTTP server of a node, so that only its port for work is open."""
    node.http_server.stop()


def stop_event() -> asyncio.Event:
    """An event that SIGTERM and SIGINT set."""
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    return stop


_OPTIONS: Final[dict[str, object]] = {
    # Dask does not retry: the rows of the chunks count attempts.
    "distributed.scheduler.allowed-failures": 0,
    # A worker holds one chunk at a time, so that its death affects only one.
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.worker-ttl": "60 seconds",
    "distributed.worker.profile.enabled": False,
    "distributed.admin.pdb-on-err": False,
    "distributed.diagnostics.nvml": False,
    "distributed.comm.timeouts.connect": "5s",
    # No HTTP routes.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.scheduler.dashboard.status.task-stream-length": 0,
}


@contextmanager
def _tls_fault(name: str, fault: str) -> Iterator[None]:
    try:
        yield
    except ssl.SSLError as exc:
        detail = f"UNGHOST_TLS_{name}: {fault}; `unghost certificates` makes the files"
        raise UnusableEngine(detail) from exc


class Certificates(NamedTuple):
    """The files of one node; None if connections are not encrypted."""

    ca: Path | None = None
    cert: Path | None = None
    key: Path | None = None

    def require(self) -> None:
        """Check that the files exist and hold a matching certificate and key.

        Raises UnusableEngine with the setting, the file and what is wrong with it.
        """
        for name, path in self._asdict().items():
            if path is None:
                raise UnusableEngine(
                    f"tls:// needs UNGHOST_TLS_{name.upper()}; "
                    "`unghost certificates` makes certificates"
                )
            if not path.is_file():
                raise UnusableEngine(
                    f"UNGHOST_TLS_{name.upper()}: there is no file {str(path)!r}"
                )
        context = ssl.create_default_context()
        ca, cert, key = map(str, self)
        with _tls_fault("CA", f"in {ca!r} there is no certificate"):
            context.load_verify_locations(ca)
        with _tls_fault("CERT", f"in {cert!r} there is no certificate"):
            ssl.create_default_context().load_verify_locations(cert)
        is_key = "PRIVATE KEY-----" in Path(key).read_text("ascii", "replace")
        fault = f"does not belong to {cert!r}" if is_key else "holds no private key"
        with _tls_fault("KEY", f"{key!r} {fault}"):
            context.load_cert_chain(cert, key)


def prepare() -> None:
    """Configure Dask; raises UnusableEngine if it is not installed."""
    try:
        import dask

        import_module("distributed")  # it sets the defaults that are changed below
    except ImportError as exc:
        raise UnusableEngine(
            "workers need more packages: pip install 'unghost[cluster]'"
        ) from exc
    dask.config.set(_OPTIONS)
    logging.getLogger("distributed").setLevel(logging.WARNING)
    # These log with a traceback what a job's driver logs in one line.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    logging.getLogger("tornado.application").addFilter(_is_no_lost_connection)


def _is_no_lost_connection(record: logging.LogRecord) -> bool:
    from distributed.comm import CommClosedError

    return not (record.exc_info and isinstance(record.exc_info[1], CommClosedError))


def security(files: Certificates, *, encrypted: bool) -> Security:
    """Dask's settings for encryption: the certificate of a node, and its authority."""
    from distributed import Security

    if not encrypted:
        return Security(require_encryption=False)
    files.require()
    roles = ("client", "scheduler", "worker")
    own = {f"tls_{role}_cert": str(files.cert) for role in roles}
    own |= {f"tls_{role}_key": str(files.key) for role in roles}
    return Security(require_encryption=True, tls_ca_file=str(files.ca), **own)


def reason_of(error: BaseException) -> str:
    """The text of the first cause of an error of Dask."""
    cause: BaseException | None = error
    reason = type(error).__name__
    while cause is not None:
        # A cause without a text, such as a timeout, is skipped.
        reason = getattr(cause, "strerror", None) or str(cause) or reason
        cause = cause.__cause__
    return reason
