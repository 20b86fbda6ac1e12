"""`unghost export`: the clean labels as a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from unghost.cli.command import command
from unghost.cli.options import DatasetName, ServerOptions
from unghost.client import Client
from unghost.work_results import Export


@dataclass(frozen=True, kw_only=True)
class ExportOptions(ServerOptions):
    """Options of `unghost export`."""

    dataset: DatasetName
    format: Annotated[str, typer.Option("--format", help="yolo or decisions-jsonl.")]
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The file to write.", dir_okay=False)
    ]
    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option",
            "-O",
            metavar="KEY=VALUE",
            help="An option of the format, such as include=all or split=0.9.",
        ),
    ] = None


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "export")(export)


def export(options: ExportOptions) -> None:
    """Have the server write a dataset's labels, and download them."""
    screen = options.screen
    given = dict(_pair(text) for text in options.option or ())
    with options.connect() as client:
        started = client.start_export(options.dataset, options.format, **given)
        screen.note(f"export {started.id} of {options.dataset} ({options.format})")
        done = client.wait_for_export(started)
        _download(client, done, options)
    screen.record({**done.raw, "path": str(options.output)}, str(options.output))


def _download(client: Client, done: Export, options: ExportOptions) -> None:
    with options.screen.progress("download", "kB") as advance:
        client.download(
            done,
            options.output,
            progress=lambda have, size: advance(_kb(have), size and _kb(size)),
        )


def _kb(size_bytes: int) -> int:
    # Rounded up: the last one is reached with the last byte.
    return -(-size_bytes // 1000)


def _pair(text: str) -> tuple[str, object]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise typer.BadParameter(f"--option {text!r} is not of the form KEY=VALUE")
    return key, _value(value)


def _value(text: str) -> object:
    """A number or a truth value where it reads like one, as in YAML."""
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text) if "." in text else int(text)
    except ValueError:
        return text
