"""Several machines: `unghost worker`, `scheduler` and `certificates`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer

from unghost.cli.options import DataFolder, OutputOptions, settings_of, written_file
from unghost.cli.screen import DONE, REFUSED, UNAVAILABLE, Refused, refused_on

if TYPE_CHECKING:
    from distributed import Client

    from app.settings import Settings

Port: TypeAlias = Annotated[
    int, typer.Option(help="Port to listen on; 0 for any free one.", min=0, max=65535)
]

_file: Final = partial(written_file, metavar="FILE")
"""An option for a file, with this `help`."""

_OPTION_OF_SETTING: Final = {"tls_ca": "--ca", "tls_cert": "--cert", "tls_key": "--key"}
"""The options of a node by the settings that they override."""


@dataclass(frozen=True, kw_only=True)
class NodeOptions(OutputOptions):
    """The certificate options of a node of a cluster."""

    ca: Annotated[
        Path | None,
        _file(help="Certificate of the authority; default: UNGHOST_TLS_CA."),
    ] = None
    cert: Annotated[
        Path | None, _file(help="Certificate of this node; default: UNGHOST_TLS_CERT.")
    ] = None
    key: Annotated[
        Path | None, _file(help="Private key of this node; default: UNGHOST_TLS_KEY.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class WorkerOptions(NodeOptions):
    scheduler: Annotated[
        str | None,
        typer.Argument(
            help="Address of the scheduler, such as tls://HOST:8786; default: "
            "UNGHOST_ENGINE.",
            show_default=False,
        ),
    ] = None
    data: DataFolder = None
    threads: Annotated[
        int | None,
        typer.Option(
            help="Threads that measure pixels; default: UNGHOST_WORKERS, else one per "
            "core.",
            min=1,
            max=256,
        ),
    ] = None
    host: Annotated[
        str | None,
        typer.Option(
            help="Address at which the scheduler reaches this worker; default: the "
            "address from which this machine reaches the scheduler."
        ),
    ] = None
    port: Port = 0
    patience: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            min=1,
            help="How long to wait for the scheduler and the database.",
        ),
    ] = 60.0


@dataclass(frozen=True, kw_only=True)
class SchedulerOptions(NodeOptions):
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1"
    port: Port = 8786


@dataclass(frozen=True, kw_only=True)
class CertificatesOptions(OutputOptions):
    folder: Annotated[
        Path,
        typer.Argument(help="Folder to write the certificates to.", file_okay=False),
    ]
    host: Annotated[
        list[str], typer.Option(help="Name or address of a node; may be repeated.")
    ]
    days: Annotated[
        int,
        typer.Option(
            help="Days for which the certificates are valid.", min=1, max=36500
        ),
    ] = 825


def worker(options: WorkerOptions) -> None:
    """Execute runs and exports of a service, until the scheduler has ended.

    Give it the same settings of database and storage as the service. Exit code 69 if
    no scheduler accepts it, or no database answers.
    """
    from app.engine.chunk import UnusableEngine
    from app.logs import configure_logging
    from app.process import worker as working

    settings = settings_of(
        {**_OPTION_OF_SETTING, "engine": "SCHEDULER", "workers": "--threads"},
        engine=options.scheduler,
        data=options.data,
        workers=options.threads,
        tls_ca=options.ca,
        tls_cert=options.cert,
        tls_key=options.key,
    )
    configure_logging(settings.log_level, settings.log_format)
    endpoint = working.WorkerEndpoint(options.host, options.port, options.patience)
    with refused_on(UnusableEngine):
        status = working.Supervisor(settings, endpoint).run()
    codes = {working.REFUSED: REFUSED, working.AWAY: UNAVAILABLE}
    raise typer.Exit(codes.get(status, DONE))


def scheduler(options: SchedulerOptions) -> None:
    """Pass the work of services on to workers, until interrupted.

    With certificates it listens on --host; without, only on this machine.
    """
    from app.engine.chunk import UnusableEngine
    from app.engine.dask import Certificates, run_scheduler

    settings = settings_of(
        _OPTION_OF_SETTING,
        tls_ca=options.ca,
        tls_cert=options.cert,
        tls_key=options.key,
    )

    def ready(address: str) -> None:
        options.screen.record(
            {"scheduler": address}, f"The scheduler listens at {address}"
        )

    shown = Certificates(settings.tls_ca, settings.tls_cert, settings.tls_key)
    with refused_on(UnusableEngine):
        run_scheduler(options.host, options.port, shown, ready)


def settings_of_node(engine: str, options: NodeOptions) -> Settings:
    """The settings with this address of a scheduler, and with the certificates.

    Raises `typer.BadParameter`: the address cannot be used, or another setting.
    """
    return settings_of(
        _OPTION_OF_SETTING,
        engine=engine,
        tls_ca=options.ca,
        tls_cert=options.cert,
        tls_key=options.key,
    )


@contextmanager
def connected(engine: str, options: NodeOptions) -> Iterator[Client]:
    """A connection to the scheduler at this address; notes if no worker has joined.

    Raises `Refused`: the address or a certificate cannot be used, or no scheduler
    accepts it.
    """
    from app.engine.chunk import UnusableEngine
    from app.engine.dask import Certificates, prepare, reason_of, security

    settings = settings_of_node(engine, options)
    address = settings.engine
    shown = Certificates(settings.tls_ca, settings.tls_cert, settings.tls_key)
    with refused_on(UnusableEngine):
        prepare()
        encrypted = security(shown, encrypted=address.startswith("tls://"))
    from distributed import Client

    try:
        client = Client(address, security=encrypted, set_as_default=False, timeout=5)
    except (OSError, ValueError) as error:
        reason = reason_of(error)
        raise Refused(f"no scheduler accepts this at {address}: {reason}") from error
    with client:
        if not client.nthreads():
            options.screen.note(
                f"waiting for a worker to join {address}; `unghost worker` starts one"
            )
        yield client


def certificates(options: CertificatesOptions) -> None:
    """Create an authority, and certificates for scheduler, workers and services.

    Anybody who has ca.key can admit more nodes: keep it off the nodes.
    """
    from app.engine.chunk import UnusableEngine

    with refused_on(UnusableEngine):
        try:
            from app.engine.certificates import make_certificates
        except ImportError as exc:
            raise UnusableEngine(
                "certificates need more packages: pip install 'unghost[cluster]'"
            ) from exc
        made = make_certificates(options.folder, tuple(options.host), options.days)
    for file in made:
        options.screen.record({"file": str(file)}, str(file))
