"""`unghost demo`: a rendered street with ghosts, filtered and served."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import typer

from unghost.cli.command import command
from unghost.cli.demo_filling import Filling
from unghost.cli.exits import PARTLY
from unghost.cli.options import OutputOptions
from unghost.cli.screen import Screen
from unghost.cli.serve import Port, settings_of, told_when_unservable

_DEFAULT_DATA: Final = Path("demo-data")


@dataclass(frozen=True, kw_only=True)
class DemoOptions(OutputOptions):
    """Options of `unghost demo`."""

    frames: Annotated[
        int, typer.Option(min=1, max=10_000, help="Frames to render.")
    ] = 48
    seed: Annotated[
        int, typer.Option(min=0, help="Another seed gives another street.")
    ] = 0
    data: Annotated[
        Path | None,
        typer.Option(
            "--data",
            metavar="DIR",
            help="Folder of everything; else UNGHOST_DATA, else ./demo-data.",
            file_okay=False,
        ),
    ] = None
    port: Port = None
    exit_when_ready: Annotated[
        bool, typer.Option("--exit-when-ready", help="Stop as soon as all is there.")
    ] = False


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "demo")(demo)


def demo(options: DemoOptions) -> None:
    """Render a small street with ghost boxes, filter it, and serve the review page.

    The street is rendered once and kept in the data folder. Serves until interrupted.
    """
    from app import startup

    screen = options.screen
    folder = options.data
    if folder is None and "UNGHOST_DATA" not in os.environ:
        folder = _DEFAULT_DATA
    # One line per request would drown the bars; whoever wants them asks for them.
    quiet = None if "UNGHOST_LOG_LEVEL" in os.environ else "warning"
    settings = settings_of(data=folder, port=options.port, log_level=quiet)
    with told_when_unservable():
        startup.check_free(settings)  # rendering takes long
    street = rendered_street(settings.data, options, screen)
    filling = Filling(
        street, screen, settings.token_file, stop_when_done=options.exit_when_ready
    )
    with told_when_unservable():
        startup.serve(
            settings, on_ready=lambda link: filling.start(link.url.partition("/#")[0])
        )
    filling.raise_if_failed()
    if filling.refused:
        raise typer.Exit(PARTLY)


def rendered_street(data: Path, options: DemoOptions, screen: Screen) -> Path:
    """The folder of the street's frames, rendered unless that was done before."""
    from app.demo.writing import write_street
    from app.storage import make_folder

    name = f"street-{options.seed}-{options.frames}"
    folder = data / "demo" / name
    if folder.exists():
        return folder
    # Renamed when it is complete: an interrupted rendering is never taken for one.
    partial = folder.with_name(f"{name}.part")
    make_folder(partial)  # the first to be made in the data folder, and that itself
    with screen.progress("render the street", "frames") as advance:
        write_street(
            partial, frames=options.frames, seed=options.seed, progress=advance
        )
    partial.rename(folder)
    return folder
