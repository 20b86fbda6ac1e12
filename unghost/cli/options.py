"""Options that several commands share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from unghost.cli.screen import Screen
from unghost.client import Client

DatasetName: TypeAlias = Annotated[str, typer.Argument(help="Name of the dataset.")]
ConfigFile: TypeAlias = Annotated[
    Path,
    typer.Option(
        "--config",
        help="A filter configuration (YAML).",
        exists=True,
        dir_okay=False,
        readable=True,
    ),
]


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """How to print."""

    json: Annotated[
        bool, typer.Option("--json", help="Print JSON lines instead of text.")
    ] = False

    @property
    def screen(self) -> Screen:
        """Where the output goes."""
        return Screen(as_json=self.json)


@dataclass(frozen=True, kw_only=True)
class ServerOptions(OutputOptions):
    """Which server, and how to print."""

    server: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="The server; else UNGHOST_SERVER, else http://127.0.0.1:8000.",
        ),
    ] = None
    token: Annotated[
        str | None,
        typer.Option(
            help="The token; else UNGHOST_TOKEN, else that of a server on this machine."
        ),
    ] = None

    def connect(self) -> Client:
        """A client of the server that was meant."""
        return Client(self.server, self.token)
