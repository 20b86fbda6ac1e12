"""`unghost run`: apply a configuration to a dataset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from unghost.cli.command import command
from unghost.cli.options import ConfigFile, DatasetName, ServerOptions
from unghost.cli.waiting import run_line, wait_for_run


@dataclass(frozen=True, kw_only=True)
class RunOptions(ServerOptions):
    """Options of `unghost run`."""

    dataset: DatasetName
    config: ConfigFile
    activate: Annotated[
        bool, typer.Option("--activate", help="Make it what counts when it is done.")
    ] = False
    wait: Annotated[
        bool, typer.Option("--wait", help="Return when it is done, with a bar.")
    ] = False


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "run")(run)


def run(options: RunOptions) -> None:
    """Apply a configuration to a whole dataset.

    The verdicts that count stay as they are, unless --activate.
    """
    with options.connect() as client:
        text = options.config.read_text(encoding="utf-8")
        version = client.add_config(options.dataset, text)
        started = client.start_run(
            options.dataset, version.digest, activate=options.activate
        )
        if options.wait:
            started = wait_for_run(client, started, options.screen)
    options.screen.record(started.raw, run_line(started))
