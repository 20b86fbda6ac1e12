"""`unghost datasets` lists the datasets, `unghost stats` counts the boxes of one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from unghost.cli.options import DatasetOptions, ServerOptions
from unghost.cli.screen import Screen, most_first

if TYPE_CHECKING:
    from unghost.wire.datasets import Dataset, Stats

_DATASET_COLUMNS: Final = (
    "dataset",
    "frames",
    "boxes",
    "kept",
    "rejected",
    "unmeasured",
    "to review",
)


_TOTALS: Final = (
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


_CLASS_COLUMNS: Final = ("class", "boxes", "kept", "rejected", "unmeasured", "% kept")


def datasets(options: ServerOptions) -> None:
    """List the datasets with their counts."""
    with options.connect() as client:
        options.screen.listing(_DATASET_COLUMNS, client.datasets(), _row)


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


def stats(options: DatasetOptions) -> None:
    """Count a dataset's boxes by verdict, reason and class.

    Conflicts are boxes that the filter keeps and a person rejects, or the reverse.
    """
    with options.connect() as client:
        numbers = client.stats(options.dataset)
    options.screen.record(numbers.raw)
    _print_stats(numbers, options.screen)


def _print_stats(numbers: Stats, screen: Screen) -> None:
    totals = [(name.replace("_", " "), getattr(numbers, name)) for name in _TOTALS]
    screen.table(("dataset", "number"), totals)
    screen.table(("reason", "boxes", "%"), _reasons(numbers), tag="reason")
    screen.table(_CLASS_COLUMNS, _classes(numbers), tag="class")


def _reasons(numbers: Stats) -> Iterator[tuple[object, ...]]:
    for reason, count in most_first(numbers.by_reason):
        yield reason, count, _percent(count, numbers.boxes)


def _classes(numbers: Stats) -> Iterator[tuple[object, ...]]:
    for name, counts in numbers.by_class.items():
        boxes = counts.kept + counts.rejected + counts.unmeasured
        row = (boxes, counts.kept, counts.rejected, counts.unmeasured)
        yield name, *row, _percent(counts.kept, boxes)


def _percent(part: int, whole: int) -> float | None:
    return round(100 * part / whole, 1) if whole else None
