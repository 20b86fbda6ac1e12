"""How the nodes of a cluster know each other: certificates, and what dask is told."""

from __future__ import annotations

import logging
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from app.engine.jobs import UnusableEngine

if TYPE_CHECKING:
    from distributed import Security

_OPTIONS: Final[dict[str, Any]] = {
    # The first death of a worker is told: it is the ledger that counts attempts.
    "distributed.scheduler.allowed-failures": 0,
    # A worker gets a chunk when it has none, so that its death concerns only one.
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.worker-ttl": "60 seconds",
    "distributed.worker.profile.enabled": False,
    "distributed.admin.pdb-on-err": False,
    "distributed.diagnostics.nvml": False,
    "distributed.comm.timeouts.connect": "5s",
    # Nothing of it listens but the port for work.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.scheduler.dashboard.status.task-stream-length": 0,
}


@contextmanager
def _blamed(name: str, fault: str) -> Iterator[None]:
    try:
        yield
    except ssl.SSLError as exc:
        detail = f"UNGHOST_TLS_{name}: {fault}; `unghost certificates` makes what fits"
        raise UnusableEngine(detail) from exc


class Certificates(NamedTuple):
    """Files of one node; None where the wire is not encrypted."""

    ca: Path | None = None
    cert: Path | None = None
    key: Path | None = None

    def require(self) -> None:
        """Refuse certificates that are not there, or that are something else.

        Raises
        ------
        UnusableEngine
            Names the setting, the file and what is wrong with it.
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
        self._require_contents()

    def _require_contents(self) -> None:
        context = ssl.create_default_context()
        ca, cert, key = map(str, self)
        with _blamed("CA", f"in {ca!r} there is no certificate"):
            context.load_verify_locations(ca)
        with _blamed("CERT", f"in {cert!r} there is no certificate"):
            ssl.create_default_context().load_verify_locations(cert)
        is_key = "PRIVATE KEY-----" in Path(key).read_text("ascii", "replace")
        fault = f"does not belong to {cert!r}" if is_key else "holds no private key"
        with _blamed("KEY", f"{key!r} {fault}"):
            context.load_cert_chain(cert, key)


def prepare() -> None:
    """Tell dask how it is used here.

    Raises
    ------
    UnusableEngine
        It is not installed.
    """
    try:
        import dask

        import_module("distributed")  # it brings the defaults that are changed here
    except ImportError as exc:
        raise UnusableEngine(
            "workers need more packages: pip install 'unghost[cluster]'"
        ) from exc
    dask.config.set(_OPTIONS)
    logging.getLogger("distributed").setLevel(logging.WARNING)
    # They tell with a traceback what the driver says in a line.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    logging.getLogger("tornado.application").addFilter(_is_no_lost_connection)


def _is_no_lost_connection(record: logging.LogRecord) -> bool:
    from distributed.comm import CommClosedError

    return not (record.exc_info and isinstance(record.exc_info[1], CommClosedError))


def security(files: Certificates, *, encrypted: bool) -> Security:
    """What a node shows to others, and whom it believes."""
    from distributed import Security

    if not encrypted:
        return Security(require_encryption=False)
    files.require()
    roles = ("client", "scheduler", "worker")
    own = {f"tls_{role}_cert": str(files.cert) for role in roles}
    own |= {f"tls_{role}_key": str(files.key) for role in roles}
    return Security(require_encryption=True, tls_ca_file=str(files.ca), **own)


def reason_of(error: BaseException) -> str:
    """What lies at the bottom of an error of dask, without dask's own words."""
    cause: BaseException | None = error
    said = type(error).__name__
    while cause is not None:
        # That something stopped waiting says nothing; the error above it says for what.
        said = getattr(cause, "strerror", None) or str(cause) or said
        cause = cause.__cause__
    return said
