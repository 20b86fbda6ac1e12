"""Options of the commands that work on a data folder, with or without a server."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from unghost.cli.exits import Refused
from unghost.cli.options import OutputOptions
from unghost.cli.serve import settings_of

if TYPE_CHECKING:
    from app.settings import Settings

DataFolder: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--data",
        metavar="DIR",
        help="The data folder; else UNGHOST_DATA, else ./unghost-data.",
        file_okay=False,
    ),
]


@dataclass(frozen=True, kw_only=True)
class DataOptions(OutputOptions):
    """Which data folder, and how to print."""

    data: DataFolder = None

    @property
    def settings(self) -> Settings:
        """The settings that a server of this folder would have."""
        return settings_of(data=self.data)


@contextmanager
def refusals() -> Iterator[None]:
    """Say why a command cannot do what was asked of it."""
    from app.services.data_folder import CannotMaintain

    try:
        yield
    except CannotMaintain as exc:
        raise Refused(str(exc)) from exc
