"""`unghost diff`: what one run decides otherwise than another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

import typer

from unghost.cli.command import command
from unghost.cli.options import ServerOptions
from unghost.work_results import Diff, FlipCounts

_COLUMNS: Final = ("class", "boxes", "kept -> rejected", "rejected -> kept")


@dataclass(frozen=True, kw_only=True)
class DiffOptions(ServerOptions):
    """Options of `unghost diff`."""

    before: Annotated[int, typer.Argument(metavar="RUN", help="A run's number.")]
    after: Annotated[
        int, typer.Argument(metavar="RUN", help="The number of the run to compare.")
    ]


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "diff")(diff)


def diff(options: DiffOptions) -> None:
    """Compare what two runs decide: boxes that change sides, per class.

    With --json every such box is a line, and the last line has the sums.
    """
    screen = options.screen
    with options.connect() as client:
        found = client.diff(options.after, options.before)
        if options.json:
            for flip in client.flips(options.after, options.before):
                screen.record(flip.raw)
    screen.record(
        {name: value for name, value in found.raw.items() if name in _SUMS},
    )
    screen.table(_COLUMNS, rows_of(found))
    screen.note(
        f"{found.total} of {found.compared} boxes are decided otherwise by run "
        f"{found.run} than by run {found.against}"
    )


_SUMS: Final = (
    *("run", "against", "compared", "total"),
    *("kept_to_rejected", "rejected_to_kept", "by_class", "sides_by_class"),
)


def rows_of(found: Diff) -> list[tuple[object, ...]]:
    """A row per class, those with most changes first, and one of all."""
    sides = found.sides_by_class
    # An older server does not say which way: that is not the same as none.
    unknown = None if "sides_by_class" in found.raw else (None, None)
    rows = [
        (name, count, *(unknown or _ways(sides.get(name, FlipCounts()))))
        for name, count in sorted(found.by_class.items(), key=lambda item: -item[1])
    ]
    return [*rows, ("all", found.total, *_ways(found))]


def _ways(counts: FlipCounts) -> tuple[int, int]:
    return counts.kept_to_rejected, counts.rejected_to_kept
