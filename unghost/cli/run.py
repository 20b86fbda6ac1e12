"""`unghost run`, `wait` and `cancel`: a configuration applied to a dataset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, TypeAlias

import typer

from unghost.cli.command import command
from unghost.cli.config_files import config_text, naming
from unghost.cli.options import ConfigFile, DatasetName, ServerOptions
from unghost.cli.waiting import run_line, wait_for_run

CancelOnInterrupt: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--cancel-on-interrupt",
        help="Ctrl-C also ends the run at the server; else it goes on.",
    ),
]
RunNumber: TypeAlias = Annotated[
    int, typer.Argument(metavar="RUN", help="The run's number.")
]


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
    cancel_on_interrupt: CancelOnInterrupt = False


@dataclass(frozen=True, kw_only=True)
class WaitOptions(ServerOptions):
    """Options of `unghost wait`."""

    run: RunNumber
    cancel_on_interrupt: CancelOnInterrupt = False


@dataclass(frozen=True, kw_only=True)
class CancelOptions(ServerOptions):
    """Options of `unghost cancel`."""

    run: RunNumber


def register(app: typer.Typer) -> None:
    """Add the commands."""
    command(app, "run")(run)
    command(app, "wait")(wait)
    command(app, "cancel")(cancel)


def run(options: RunOptions) -> None:
    """Apply a configuration to a whole dataset.

    The verdicts that count stay as they are, unless --activate.
    """
    with options.connect() as client:
        text = config_text(options.config)
        with naming(options.config):
            version = client.add_config(options.dataset, text)
        started = client.start_run(
            options.dataset, version.digest, activate=options.activate
        )
        if options.wait:
            started = wait_for_run(
                client, started, options.screen, cancel=options.cancel_on_interrupt
            )
    options.screen.record(started.raw, run_line(started))


def wait(options: WaitOptions) -> None:
    """Follow a run until it is done, with a bar; exit code 1 if it is not."""
    with options.connect() as client:
        found = client.run(options.run)
        done = wait_for_run(
            client, found, options.screen, cancel=options.cancel_on_interrupt
        )
    options.screen.record(done.raw, run_line(done))


def cancel(options: CancelOptions) -> None:
    """End a run that is not over; nothing in its dataset changes."""
    with options.connect() as client:
        cancelled = client.cancel(options.run)
    options.screen.record(cancelled.raw, run_line(cancelled))
