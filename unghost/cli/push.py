"""`unghost push`: a folder of frames to the server."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from unghost.cli.command import command
from unghost.cli.exits import PARTLY, REFUSED, Refused
from unghost.cli.options import ServerOptions
from unghost.cli.push_report import PushReport
from unghost.cli.source_options import SegmentationReading, SourceOptions
from unghost.cli.sources import open_source, outgoing
from unghost.client import Client
from unghost.errors import Conflict, NotFound
from unghost.outgoing import Outcome
from unghost.results import Dataset

if TYPE_CHECKING:
    from filter_core.formats.reading import FrameSet

_LOOKED_AT: Final = 500
"""Boxes without tags whose classes are named."""


@dataclass(frozen=True, kw_only=True)
class PushOptions(ServerOptions, SourceOptions, SegmentationReading):
    """Options of `unghost push`."""

    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A folder in a recognised layout, or a manifest.jsonl.",
            exists=True,
        ),
    ]
    dataset: Annotated[
        str, typer.Option("--dataset", help="Where to; made if it is not there.")
    ]
    workers: Annotated[
        int, typer.Option(min=1, max=16, help="Connections that send at the same time.")
    ] = 2
    replace: Annotated[
        bool,
        typer.Option(
            "--replace",
            help="Replace frames whose content changed, instead of refusing them.",
        ),
    ] = False


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "push")(push)


def push(options: PushOptions) -> None:
    """Upload a folder of frames, and have every box decided.

    Safe to interrupt and to repeat: what the server has is not sent again. Exit code 3
    if some frames were refused or could not be matched; they are listed.
    """
    report = PushReport(options.screen)
    found = open_source(options.source, options)
    with options.connect() as client:
        ensure_dataset(client, options.dataset, options.reading, found.classes or ())
        send(client, options, found, report)
        if report.stored:
            _note_unmapped(client, options)
    report.print_summary(found.unmatched, options.dataset)
    if report.refused or found.unmatched:
        raise typer.Exit(PARTLY if report.succeeded else REFUSED)


def ensure_dataset(
    client: Client, name: str, options: Mapping[str, str], classes: Sequence[str]
) -> Dataset:
    """The dataset, made if it is not there; its options must be the ones given."""
    try:
        dataset = client.dataset(name)
    except NotFound:
        try:
            return client.create_dataset(name, classes=list(classes) or None, **options)
        except Conflict:  # another push made it just now
            dataset = client.dataset(name)
    for option, value in options.items():
        there = getattr(dataset, option)
        if there != value:
            raise Refused(
                f"dataset {name!r} has {option} {there!r}, not {value!r}; change it in "
                "the dataset's settings, which measures every frame again"
            )
    return dataset


def send(
    client: Client, options: PushOptions, found: FrameSet, report: PushReport
) -> None:
    """Send every frame, with a bar; an interruption says how far it came."""
    with (
        options.screen.progress(f"push to {options.dataset}", "frames") as advance,
        closing(_outcomes(client, options, found)) as outcomes,
    ):
        try:
            for outcome in outcomes:
                report.add(outcome)
                advance(report.seen, found.count)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted after {report.seen} frames; the same command goes on"
            ) from None


def _note_unmapped(client: Client, options: PushOptions) -> None:
    """A class that no tag stands for loses all its boxes: mostly a mistake."""
    count = client.stats(options.dataset).by_reason.get("unmapped_class", 0)
    if not count:
        return
    boxes = client.boxes(options.dataset, reason="unmapped_class")
    found = {str(box.class_name) for box in islice(boxes, _LOOKED_AT)}
    options.screen.note(
        f"rejected: {count} boxes of {options.dataset}, since their class has no tags: "
        f"{', '.join(sorted(found))}"
    )


def _outcomes(
    client: Client, options: PushOptions, found: FrameSet
) -> Generator[Outcome, None, None]:
    return client.push(
        options.dataset,
        outgoing(found),
        replace=options.replace,
        connections=options.workers,
    )
