"""`unghost stats`: one dataset in numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import typer

from unghost.cli.command import command
from unghost.cli.options import DatasetName, ServerOptions
from unghost.work_results import Stats

_TOTALS = (
    "frames",
    "boxes",
    "kept",
    "rejected",
    "unmeasured",
    "reviewed",
    "to_review",
    "unsure",
    "conflicts",
    "lossy",
)


@dataclass(frozen=True, kw_only=True)
class StatsOptions(ServerOptions):
    """Options of `unghost stats`."""

    dataset: DatasetName


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "stats")(stats)


def stats(options: StatsOptions) -> None:
    """Count a dataset's boxes by verdict, reason and class."""
    with options.connect() as client:
        numbers = client.stats(options.dataset)
    options.screen.record(numbers.raw)
    options.screen.table(("what", "number"), _rows(numbers))


def _rows(numbers: Stats) -> Iterator[tuple[str, object]]:
    for name in _TOTALS:
        yield name.replace("_", " "), getattr(numbers, name)
    for reason, count in numbers.by_reason.items():
        yield f"reason {reason}", count
    for class_name, counts in numbers.by_class.items():
        yield (
            f"class {class_name}",
            f"{counts.kept} kept, {counts.rejected} rejected, "
            f"{counts.unmeasured} unmeasured",
        )
