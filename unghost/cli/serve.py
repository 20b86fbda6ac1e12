"""`unghost serve`: the service and its review page, on this machine."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from unghost.cli.command import command
from unghost.cli.exits import Refused
from unghost.cli.login_page import LoginPage, remove_left_over
from unghost.cli.options import OutputOptions

if TYPE_CHECKING:
    from app import startup
    from app.settings import Settings

DataFolder: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--data",
        metavar="DIR",
        help="Folder of the database and the files; else UNGHOST_DATA, "
        "else ./unghost-data.",
        file_okay=False,
    ),
]
ConfigFile: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="A filter.yaml: the first configuration of every new dataset.",
        dir_okay=False,
    ),
]
Host: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Address to listen on; else UNGHOST_HOST, else 127.0.0.1."),
]
Port: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="Port to listen on (0: any free one); else UNGHOST_PORT, else 8000.",
        min=0,
        max=65535,
    ),
]


@dataclass(frozen=True, kw_only=True)
class ServeOptions(OutputOptions):
    """Options of `unghost serve`."""

    data: DataFolder = None
    config: ConfigFile = None
    host: Host = None
    port: Port = None
    open: Annotated[
        bool, typer.Option("--open", help="Open the review page in the browser.")
    ] = False


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "serve")(serve)


def serve(options: ServeOptions) -> None:
    """Serve until interrupted; prints the login link once it is ready."""
    from app import startup

    screen = options.screen
    settings = settings_of(
        data=options.data,
        config=options.config,
        host=options.host,
        port=options.port,
    )

    stop = threading.Event()
    opened: list[threading.Thread] = []

    def ready(link: startup.LoginLink) -> None:
        remove_left_over(settings.data)
        found = {"login_link": link.url, "data": str(settings.data)}
        screen.record(found, startup.ready_text(link.url))
        if options.open:
            page = LoginPage(link.url, settings.data)
            opened.append(threading.Thread(target=_show, args=(page, link, stop)))
            opened[0].start()

    try:
        with told_when_unservable():
            startup.serve(settings, on_ready=ready)
    finally:
        stop.set()
        for thread in opened:
            thread.join()


def _show(page: LoginPage, link: startup.LoginLink, stop: threading.Event) -> None:
    if page.show():
        page.remove_when(link.is_over, stop)
    page.remove()


@contextmanager
def told_when_unservable() -> Iterator[None]:
    """Say why the service cannot start; Refused."""
    from app.startup import CannotServe

    try:
        yield
    except CannotServe as exc:
        raise Refused(str(exc)) from exc


def settings_of(**given: object) -> Settings:
    """The environment's settings, with those on top that were given."""
    from pydantic import ValidationError

    from app.settings import Settings
    from app.validation_words import in_words

    chosen: dict[str, Any] = {
        name: value for name, value in given.items() if value is not None
    }
    try:
        return Settings(**chosen)
    except ValidationError as exc:
        faults = [
            f"UNGHOST_{'_'.join(map(str, each['loc'])).upper()}: "
            f"{in_words(each, show=True)}"
            for each in exc.errors()
        ]
        raise typer.BadParameter("; ".join(faults)) from exc
