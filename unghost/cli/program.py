"""The program: its commands, and the one place where errors become exit codes."""

from __future__ import annotations

import os
import sys
from typing import Annotated, NoReturn

import httpx
import typer

from unghost.cli import (
    audit,
    backup,
    capture,
    cluster,
    config,
    convert,
    datasets,
    demo,
    diff,
    doctor,
    evaluate,
    export,
    filter_local,
    login,
    push,
    run,
    serve,
    stats,
    token,
)
from unghost.cli.exits import INTERRUPTED, REFUSED, exit_code, explain
from unghost.cli.screen import Screen

app = typer.Typer(
    name="unghost",
    help="Finds the boxes that CARLA's camera cannot see, and says why.",
    epilog="Exit codes: 0 done, 1 refused, 2 usage, 3 partly done, 69 server away, "
    "130 interrupted.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_GROUPS = (
    *(serve, login, demo, push, filter_local, run, stats, diff),
    *(datasets, export, convert, evaluate, audit, capture),
    *(backup, doctor, cluster),
)
for group in _GROUPS:
    group.register(app)
app.add_typer(config.app, name="config")
app.add_typer(token.app, name="token")


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        Screen().text(f"unghost {version('unghost')}")
        raise typer.Exit


@app.callback()
def unghost(
    _version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_print_version,
            is_eager=True,
            help="Print the version and exit.",
        ),
    ] = False,
) -> None:
    """Finds the boxes that CARLA's camera cannot see, and says why."""


def main() -> NoReturn:
    """Run the command line and exit with a code that means something."""
    try:
        app()
    except KeyboardInterrupt:
        Screen().note("interrupted")
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        # The reader of our output has gone, as `| head` does: nobody to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(REFUSED)
    except (Exception, httpx.TransportError) as error:
        code = exit_code(error)
        if code is None:
            raise
        for line in explain(error):
            Screen().note(f"unghost: {line}" if line[:1] != " " else line)
        sys.exit(code)
    sys.exit(0)
