"""`unghost stats`: one dataset in numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import typer

from unghost.cli.command import command
from unghost.cli.options import DatasetName, ServerOptions
from unghost.cli.screen import Screen
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
    "toss_ups",
    "lossy",
)
_CLASS_COLUMNS = ("class", "boxes", "kept", "rejected", "unmeasured", "% kept")


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
    print_stats(numbers, options.screen)


def print_stats(numbers: Stats, screen: Screen) -> None:
    """Three tables: the whole, by reason, by class."""
    totals = [(name.replace("_", " "), getattr(numbers, name)) for name in _TOTALS]
    screen.table(("dataset", "number"), totals)
    screen.table(("reason", "boxes", "%"), _reasons(numbers), tag="reason")
    screen.table(_CLASS_COLUMNS, _classes(numbers), tag="class")


def _reasons(numbers: Stats) -> Iterator[tuple[object, ...]]:
    by_count = sorted(numbers.by_reason.items(), key=lambda item: -item[1])
    for reason, count in by_count:
        yield reason, count, _percent(count, numbers.boxes)


def _classes(numbers: Stats) -> Iterator[tuple[object, ...]]:
    for name, counts in numbers.by_class.items():
        boxes = counts.kept + counts.rejected + counts.unmeasured
        row = (boxes, counts.kept, counts.rejected, counts.unmeasured)
        yield name, *row, _percent(counts.kept, boxes)


def _percent(part: int, whole: int) -> float | None:
    return round(100 * part / whole, 1) if whole else None
