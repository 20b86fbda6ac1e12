"""`unghost serve` and `unghost demo`: the service and its page, on this machine.

The demo renders a street with ghost boxes and uploads it through the API while the
service runs.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer

from unghost.cli.access import remove_login_pages, show_login_page
from unghost.cli.options import DataFolder, OutputOptions, settings_of
from unghost.cli.push import PushReport
from unghost.cli.screen import PARTLY, Screen, most_first, refused_on
from unghost.cli.sources import SourceOptions, open_source, outgoing
from unghost.cli.target import NewDataset, ensure_dataset

if TYPE_CHECKING:
    from app import serve as startup
    from unghost.client.client import Client
    from unghost.wire.datasets import Stats

_DEMO_DATA: Final = Path("demo-data")
_DEMO_DATASET: Final = "demo"

Port: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="Port to listen on, 0 for any free one; default: UNGHOST_PORT, else 8000.",
        min=0,
        max=65535,
    ),
]


@dataclass(frozen=True, kw_only=True)
class ServeOptions(OutputOptions):
    """Options of `unghost serve`."""

    data: DataFolder = None
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            metavar="FILE",
            help="A filter configuration (YAML): the first one of every new dataset.",
            dir_okay=False,
        ),
    ] = None
    host: Annotated[
        str | None,
        typer.Option(
            help="Address to listen on; default: UNGHOST_HOST, else 127.0.0.1."
        ),
    ] = None
    port: Port = None
    open: Annotated[
        bool, typer.Option("--open", help="Open the review page in the browser.")
    ] = False


def serve(options: ServeOptions) -> None:
    """Serve the review page and the API until interrupted.

    Prints a login link when it is ready.
    """
    from app import serve as startup

    screen = options.screen
    settings = settings_of(
        data=options.data, config=options.config, host=options.host, port=options.port
    )
    stop = threading.Event()
    opened: list[threading.Thread] = []

    def ready(link: startup.LoginLink) -> None:
        # Left behind by a service that was killed.
        remove_login_pages(settings.data)
        found = {"login_link": link.url, "data": str(settings.data)}
        screen.record(found, startup.ready_text(link.url))
        if options.open:
            arguments = (link.url, settings.data, link.is_over, stop)
            opened.append(threading.Thread(target=show_login_page, args=arguments))
            opened[0].start()

    try:
        with refused_on(startup.CannotServe):
            startup.serve(settings, on_ready=ready)
    finally:
        stop.set()
        for thread in opened:
            thread.join()


@dataclass(frozen=True, kw_only=True)
class DemoOptions(OutputOptions):
    """Options of `unghost demo`."""

    frames: Annotated[
        int, typer.Option(min=1, max=10_000, help="Number of frames to render.")
    ] = 48
    seed: Annotated[
        int,
        typer.Option(
            min=0,
            help="Number that the street is drawn from; each gives another street.",
        ),
    ] = 0
    data: Annotated[
        Path | None,
        typer.Option(
            "--data",
            metavar="DIR",
            help="Data folder; default: UNGHOST_DATA, else ./demo-data.",
            file_okay=False,
        ),
    ] = None
    port: Port = None
    exit_when_ready: Annotated[
        bool, typer.Option("--exit-when-ready", help="Exit when the demo is ready.")
    ] = False


def demo(options: DemoOptions) -> None:
    """Render a small street with ghost boxes, filter it, and serve the review page.

    The street is rendered once and kept in the data folder. Serves until interrupted.
    """
    from app import serve as startup

    screen = options.screen
    folder = options.data
    if folder is None and "UNGHOST_DATA" not in os.environ:
        folder = _DEMO_DATA
    # A log line per request would hide the bars, so by default there are none.
    quiet = None if "UNGHOST_LOG_LEVEL" in os.environ else "warning"
    settings = settings_of(data=folder, port=options.port, log_level=quiet)
    with refused_on(startup.CannotServe):
        startup.check_free(settings)  # rendering takes long
    street = rendered_street(settings.data, options, screen)
    filling = _Filling(
        street, screen, settings.token_file, stop_when_done=options.exit_when_ready
    )
    with refused_on(startup.CannotServe):
        startup.serve(
            settings, on_ready=lambda link: filling.start(link.url.partition("/#")[0])
        )
    filling.raise_if_failed()
    if filling.refused:
        raise typer.Exit(PARTLY)


def rendered_street(data: Path, options: DemoOptions, screen: Screen) -> Path:
    """The folder of the street's frames, rendered unless that was done before."""
    from app.storage.durable import make_folder
    from unghost.street.street import write_street

    name = f"street-{options.seed}-{options.frames}"
    folder = data / "demo" / name
    if folder.exists():
        return folder
    # Renamed when complete, so that an interrupted rendering is never used.
    partial = folder.with_name(f"{name}.part")
    make_folder(partial)
    with screen.progress("render the street", "frames") as advance:
        write_street(
            partial, frames=options.frames, seed=options.seed, progress=advance
        )
    partial.rename(folder)
    return folder


class _Filling:
    """Uploads the street in a thread, because the main thread runs the server."""

    def __init__(
        self, street: Path, screen: Screen, token_file: Path, *, stop_when_done: bool
    ) -> None:
        self._street = street
        self._screen = screen
        self._token_file = token_file
        self._stop_when_done = stop_when_done
        self._error: Exception | None = None
        self.refused = 0

    def start(self, url: str) -> None:
        """Start the thread; called when the server is ready."""
        # A daemon thread: an interruption does not wait for the frames.
        threading.Thread(target=self._run, args=(url,), daemon=True).start()

    def raise_if_failed(self) -> None:
        """Raise the error of the thread, if there was one."""
        if self._error is not None:
            raise self._error

    def _run(self, url: str) -> None:
        try:
            self._fill(url)
        except Exception as error:  # raised again by the main thread
            self._error = error
        if self._error is not None or self._stop_when_done:
            # As for Ctrl-C, on which the server shuts down in order.
            signal.raise_signal(signal.SIGINT)

    def _fill(self, url: str) -> None:
        from unghost.client.client import Client

        token = self._token_file.read_text(encoding="utf-8").strip()
        with Client(url, token) as client:
            report = self._push(client)
            numbers = client.stats(_DEMO_DATASET)
            # Created now: rendering and uploading may take longer than a link is valid.
            login_link = f"{url}/#code={client.create_login_code().code}"
        self.refused = report.refused
        report.print_problems()
        self._screen.record(
            {"login_link": login_link, "dataset": _DEMO_DATASET, "stats": numbers.raw}
        )
        self._screen.table(("boxes", "verdict", "reason"), _reason_rows(numbers))
        self._screen.text(
            f"\nLog in with\n\n    {login_link}\n\n"
            "The link works once, within ten minutes; `unghost login` prints another.\n"
        )

    def _push(self, client: Client) -> PushReport:
        report = PushReport(Screen())
        described = SourceOptions().describe(self._street)
        found = open_source(self._street, "manifest", described)
        new = NewDataset(classes=found.classes or ())
        ensure_dataset(client, _DEMO_DATASET, new, self._screen)
        with self._screen.progress("filter the street", "frames") as advance:
            for outcome in client.push(_DEMO_DATASET, outgoing(found)):
                report.add(outcome)
                advance(report.seen, found.count)
        return report


def _reason_rows(numbers: Stats) -> Iterator[tuple[object, ...]]:
    from filter_core.types import Reason

    verdicts: dict[str, str] = {reason.label: reason.verdict.value for reason in Reason}
    for reason, count in most_first(numbers.by_reason):
        yield count, verdicts.get(reason, ""), reason.replace("_", " ")
