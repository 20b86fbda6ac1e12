"""`unghost datasets`: what the server holds."""

from __future__ import annotations

import typer

from unghost.cli.command import command
from unghost.cli.options import ServerOptions
from unghost.results import Dataset

_COLUMNS = ("dataset", "frames", "boxes", "kept", "rejected", "unmeasured", "to review")


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "datasets")(datasets)


def datasets(options: ServerOptions) -> None:
    """List the datasets with their counts."""
    screen = options.screen
    with options.connect() as client:
        found = list(client.datasets())
    for dataset in found:
        screen.record(dataset.raw)
    screen.table(_COLUMNS, [_row(dataset) for dataset in found])


def _row(dataset: Dataset) -> tuple[object, ...]:
    counts = dataset.counts
    return (
        dataset.name,
        counts.frames,
        counts.boxes,
        counts.kept,
        counts.rejected,
        counts.unmeasured,
        counts.to_review,
    )
