"""`unghost export`: the clean labels as a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from unghost.cli.command import command
from unghost.cli.format_options import FORMATS_HELP, FormatOptions
from unghost.cli.options import DatasetName, ServerOptions
from unghost.cli.waiting import wait_for_export
from unghost.client import Client
from unghost.work_results import Export


@dataclass(frozen=True, kw_only=True)
class ExportOptions(ServerOptions, FormatOptions):
    """Options of `unghost export`."""

    dataset: DatasetName
    format: Annotated[str, typer.Option("--format", help=FORMATS_HELP)]
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The file to write.", dir_okay=False)
    ]


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "export")(export)


def export(options: ExportOptions) -> None:
    """Have the server write a dataset's labels, and download them.

    An interrupted download goes on where it stopped: the same labels are the same file.
    """
    screen = options.screen
    with options.connect() as client:
        started = client.start_export(options.dataset, options.format, **options.given)
        screen.note(f"export {started.id} of {options.dataset} ({options.format})")
        done = wait_for_export(client, started, screen)
        _download(client, done, options)
    screen.record({**done.raw, "path": str(options.output)}, str(options.output))


def _download(client: Client, done: Export, options: ExportOptions) -> None:
    try:
        with options.screen.progress("download", "kB") as advance:
            client.download(
                done,
                options.output,
                progress=lambda have, size: advance(_kb(have), size and _kb(size)),
            )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted; the same command goes on with {options.output}"
        ) from None


def _kb(size_bytes: int) -> int:
    # Rounded up: the last one is reached with the last byte.
    return -(-size_bytes // 1000)
