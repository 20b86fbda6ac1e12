"""Commands that list boxes, frames, refused frames and runs."""

from __future__ import annotations

import csv
import io
import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, TypeVar

import typer

from unghost.cli.options import (
    DatasetOptions,
    OutputOptions,
    ServerOptions,
    dataset_names,
    written_file,
)
from unghost.cli.screen import Refused
from unghost.wire.words import Bin, JobState, ReviewState, Verdict

if TYPE_CHECKING:
    from unghost.client.tables import Columns

TableFormat = Literal["csv", "json", "parquet"]
_Listed = TypeVar("_Listed")


@dataclass(frozen=True, kw_only=True)
class ListOptions(OutputOptions):
    """How much to list, and how to print."""

    limit: Annotated[
        int, typer.Option(min=0, help="Maximum number to list; 0 for all.")
    ] = 0

    def first(self, listed: Iterable[_Listed]) -> Iterator[_Listed]:
        """As many of them as were asked for."""
        return islice(listed, self.limit or None)


@dataclass(frozen=True, kw_only=True)
class BoxesOptions(DatasetOptions, ListOptions):
    format: Annotated[
        TableFormat | None,
        typer.Option(
            help="How to write the table; json: one object per line. Default: what the "
            "name of the file ends in, else csv."
        ),
    ] = None
    output: Annotated[
        Path | None,
        written_file(
            "--output",
            "-o",
            metavar="FILE",
            help="File to write; default: the standard output.",
        ),
    ] = None
    fields: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="Columns, separated by commas; default: all that are read fast. "
            "docs/client.md lists them.",
        ),
    ] = ""
    verdict: Annotated[
        Verdict | None, typer.Option(help="Only boxes with this verdict of the filter.")
    ] = None
    effective: Annotated[
        Verdict | None,
        typer.Option(help="Only boxes with this verdict, answers of people included."),
    ] = None
    reason: Annotated[
        str | None, typer.Option(help="Only boxes with one of these reasons.")
    ] = None
    class_name: Annotated[
        str | None, typer.Option("--class", help="Only boxes of these classes.")
    ] = None
    review: Annotated[
        ReviewState | None, typer.Option(help="Only boxes with such an answer.")
    ] = None
    bin: Annotated[
        Bin | None, typer.Option(help="Only boxes to ask about, or others of a kind.")
    ] = None
    frame: Annotated[
        str | None, typer.Option(metavar="KEY", help="Only boxes of this frame.")
    ] = None
    map: Annotated[
        str | None, typer.Option(help="Only boxes of frames on this map.")
    ] = None
    camera: Annotated[
        str | None, typer.Option(help="Only boxes of frames of this camera.")
    ] = None
    sequence: Annotated[
        str | None, typer.Option(help="Only boxes of frames of this drive.")
    ] = None
    weather: Annotated[
        str | None, typer.Option(help="Only boxes of frames with this weather.")
    ] = None
    distance_min: Annotated[
        float | None, typer.Option(min=0, help="Only boxes at least so far, in metres.")
    ] = None
    distance_max: Annotated[
        float | None, typer.Option(min=0, help="Only boxes at most so far, in metres.")
    ] = None


_FORMATS: Final[dict[str, TableFormat]] = {
    ".parquet": "parquet",
    ".json": "json",
    ".jsonl": "json",
}
"""What a file is written as whose name ends so, if --format does not say it."""


def boxes(options: BoxesOptions) -> None:
    """Write the boxes of a dataset as a table: CSV, JSON or Parquet."""
    suffix = options.output.suffix if options.output is not None else ""
    kind = "json" if options.json else options.format or _FORMATS.get(suffix, "csv")
    if kind == "parquet" and options.output is None:
        raise Refused("--format parquet: expected --output FILE, found none")
    with options.connect() as client:
        table = client.boxes(
            options.dataset,
            verdict=options.verdict,
            effective=options.effective,
            reason=options.reason,
            class_name=options.class_name,
            review=options.review,
            bin=options.bin,
            frame=options.frame,
            map=options.map,
            camera=options.camera,
            sequence=options.sequence,
            weather=options.weather,
            distance_min=options.distance_min,
            distance_max=options.distance_max,
        )
        fields = options.fields.split(",") if options.fields else ()
        with options.screen.progress(f"boxes of {options.dataset}", "boxes") as advance:
            columns = table.columns(
                fields, most=options.limit, progress=lambda rows: advance(rows, None)
            )
    if kind == "parquet":
        assert options.output is not None
        from unghost.client.tables import to_arrow

        try:
            import pyarrow.parquet
        except ImportError as error:
            raise Refused(
                "Parquet needs pyarrow, which is not installed here: pip install "
                "'unghost[parquet]'"
            ) from error
        pyarrow.parquet.write_table(
            to_arrow(columns), options.output, compression="zstd"
        )
    elif options.output is None:
        sys.stdout.write(_text_of(columns, kind))
    else:
        options.output.write_text(_text_of(columns, kind), "utf-8", newline="")
    if options.output is not None:
        count = len(next(iter(columns.values()), ()))
        options.screen.note(f"{count:,} boxes in {options.output}")


def _text_of(columns: Columns, kind: str) -> str:
    rows = zip(*columns.values(), strict=True)
    if kind == "json":
        lines = (dict(zip(columns, row, strict=True)) for row in rows)
        return "".join(f"{json.dumps(line, ensure_ascii=False)}\n" for line in lines)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*map(_cells, columns.values()), strict=True))
    return text.getvalue()


_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r", "\n")


def _cells(column: Sequence[object]) -> Sequence[object]:
    """A column for CSV: words for truth; text like a formula gets an apostrophe."""
    if isinstance(next(iter(column), None), bool):
        return [str(value).lower() for value in column]
    if not any(isinstance(value, str) for value in column):
        return column
    return [
        f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value
        for value in column
    ]


@dataclass(frozen=True, kw_only=True)
class FramesOptions(DatasetOptions, ListOptions):
    key: Annotated[
        str, typer.Option(metavar="PREFIX", help="Only frames whose keys begin so.")
    ] = ""
    verdict: Annotated[
        Verdict | None, typer.Option(help="Only frames that have such a box.")
    ] = None
    map: Annotated[str | None, typer.Option(help="Only frames on this map.")] = None
    sequence: Annotated[str | None, typer.Option(help="Only frames of this drive.")] = (
        None
    )
    camera: Annotated[str | None, typer.Option(help="Only frames of this camera.")] = (
        None
    )
    weather: Annotated[
        str | None, typer.Option(help="Only frames with this weather.")
    ] = None
    distance_min: Annotated[
        float | None,
        typer.Option(min=0, help="Only frames with a box at least so far, in metres."),
    ] = None
    distance_max: Annotated[
        float | None,
        typer.Option(min=0, help="Only frames with a box at most so far, in metres."),
    ] = None


def frames(options: FramesOptions) -> None:
    """List the frames of a dataset with the counts of their boxes."""
    with options.connect() as client:
        listed = client.frames(
            options.dataset,
            key=options.key,
            verdict=options.verdict,
            map=options.map,
            sequence=options.sequence,
            camera=options.camera,
            weather=options.weather,
            distance_min=options.distance_min,
            distance_max=options.distance_max,
        )
        counts = ("boxes", "kept", "rejected", "to_review")
        options.screen.listing(
            ("frame", "number", "map", *(name.replace("_", " ") for name in counts)),
            options.first(listed),
            attrgetter("key", "id", "map", *(f"counts.{name}" for name in counts)),
        )


@dataclass(frozen=True, kw_only=True)
class ProblemsOptions(DatasetOptions, ListOptions):
    """Options of `unghost problems`."""


def problems(options: ProblemsOptions) -> None:
    """List the frames that were refused, with the errors that their sender got."""
    with options.connect() as client:
        listed = options.first(client.problems(options.dataset))
        options.screen.listing(
            ("frame", "when", "code", "error"),
            listed,
            lambda problem: (
                problem.key,
                problem.created_at.isoformat(sep=" ", timespec="seconds"),
                problem.error.code,
                problem.error.detail,
            ),
        )


@dataclass(frozen=True, kw_only=True)
class RunsOptions(ServerOptions, ListOptions):
    dataset: Annotated[
        str | None,
        typer.Argument(
            help="Name of the dataset; default: all datasets.",
            autocompletion=dataset_names,
        ),
    ] = None
    state: Annotated[JobState | None, typer.Option(help="Only runs in this state.")] = (
        None
    )


def runs(options: RunsOptions) -> None:
    """List the runs of a dataset or of all, newest first."""
    with options.connect() as client:
        listed = options.first(client.runs(options.dataset, state=options.state))
        options.screen.listing(
            ("run", "dataset", "state", "configuration", "by", "result"),
            listed,
            lambda run: (
                run.id,
                run.dataset,
                run.state,
                run.config[:12],
                run.created_by,
                f"{run.changed} boxes changed" if run.state == "done" else "",
            ),
        )
