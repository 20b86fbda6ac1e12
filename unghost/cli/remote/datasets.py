"""Commands about datasets as a whole: `unghost dataset`, and the counts of one."""

from __future__ import annotations

import base64
import html
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from unghost.cli.gates import GateOptions
from unghost.cli.options import DatasetOptions, ServerOptions, read_file, written_file
from unghost.cli.screen import Refused, most_first
from unghost.cli.sources import (
    SEGMENTATION_SETTINGS,
    ChannelOrderOption,
    EncodingOption,
)
from unghost.wire.words import LossyPolicy, Palette

if TYPE_CHECKING:
    from unghost.client.client import Client
    from unghost.wire.datasets import Dataset, Stats, VerdictCounts
    from unghost.wire.frames import FrameSummary, Report
    from unghost.wire.quality import Measure
    from unghost.wire.runs import Export

_COUNTS: Final = ("frames", "boxes", "kept", "rejected", "unmeasured")
_DATASET_COLUMNS: Final = ("dataset", *_COUNTS, "to review", "recording")
_DOUBTS: Final = ("to_review", "unsure", "conflicts", "toss_ups", "lossy")
_TOTALS: Final = (*_COUNTS, "reviewed", *_DOUBTS)
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
        "described" if dataset.recording else None,
    )


@dataclass(frozen=True, kw_only=True)
class SettingsOptions(DatasetOptions):
    """Settings of a dataset; what is not given is not changed, or has its default."""

    description: Annotated[
        str | None, typer.Option(help="Text for people about the dataset.")
    ] = None
    palette: Annotated[
        Palette | None, typer.Option(help="Table of tags of the segmentations.")
    ] = None
    encoding: EncodingOption = None
    channel_order: ChannelOrderOption = None
    lossy_segmentation: Annotated[
        LossyPolicy | None,
        typer.Option(help="What happens to segmentations whose colours are not exact."),
    ] = None

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that were given, by their names."""
        names = ("description", *SEGMENTATION_SETTINGS)
        values = {name: getattr(self, name) for name in names}
        return {name: value for name, value in values.items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class CreateOptions(SettingsOptions):
    classes: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Names of the classes in their order, separated by commas; default: "
            "those of CARLA.",
        ),
    ] = None
    config: Annotated[
        Path | None,
        read_file(help="The first filter configuration (YAML); default: the server's."),
    ] = None
    exist_ok: Annotated[
        bool, typer.Option("--exist-ok", help="Leave a dataset of this name as it is.")
    ] = False


def create(options: CreateOptions) -> None:
    """Create a dataset. `unghost push` does so too, from what a folder shows."""
    from unghost.cli.remote.target import GivenConfig

    config = GivenConfig.of(options.config, {}).whole
    classes = options.classes.split(",") if options.classes else None
    with options.connect() as client:
        dataset = client.create_dataset(
            options.dataset,
            exist_ok=options.exist_ok,
            classes=classes,
            config=config,
            **options.settings,
        )
    options.screen.record(dataset.raw, f"{dataset.name}: {', '.join(dataset.classes)}")


def show(options: DatasetOptions) -> None:
    """Show the settings and the counts of a dataset."""
    with options.connect() as client:
        dataset = client.dataset(options.dataset)
    options.screen.record(dataset.raw)
    told = {name.replace("_", " "): getattr(dataset, name) for name in _SHOWN}
    told["created at"] = dataset.created_at.isoformat(sep=" ", timespec="seconds")
    counts = zip(_DATASET_COLUMNS[1:-1], _row(dataset)[1:-1], strict=True)
    rows = [*told.items(), ("classes", ", ".join(dataset.classes)), *counts]
    options.screen.table(("dataset", dataset.name), rows)


_SHOWN: Final = ("description", *SEGMENTATION_SETTINGS, "classes_frozen", "active_run")


def edit(options: SettingsOptions) -> None:
    """Change settings of a dataset; waits if images have to be measured again."""
    from unghost.cli.remote.runs import wait_for_run
    from unghost.wire.runs import Run

    if not options.settings:
        raise Refused("expected a setting to change, such as --description; found none")
    with options.connect() as client:
        changed = client.change_dataset(options.dataset, **options.settings)
        if isinstance(changed, Run):
            wait_for_run(client, changed, options.screen)
        dataset = client.dataset(options.dataset)
    names = ", ".join(options.settings)
    options.screen.record(dataset.raw, f"{dataset.name}: {names} changed")


@dataclass(frozen=True, kw_only=True)
class DeleteOptions(DatasetOptions):
    yes: Annotated[
        bool, typer.Option("--yes", help="Delete it without asking for its name.")
    ] = False


def delete(options: DeleteOptions) -> None:
    """Delete a dataset with its frames and people's answers; needs the role admin."""
    with options.connect() as client:
        counts = client.dataset(options.dataset).counts
        what = (
            f"{options.dataset}: {counts.frames:,} frames, {counts.boxes:,} boxes, "
            f"{counts.reviewed:,} answers"
        )
        if not options.yes:
            if not sys.stdin.isatty():
                raise Refused(f"{what}; --yes deletes them without asking")
            typed = typer.prompt(f"{what}. Type the name to delete it", err=True)
            if typed != options.dataset:
                raise Refused(f"expected {options.dataset!r}, found {typed!r}")
        client.delete_dataset(options.dataset)
    options.screen.note(f"{what}: deleted")


@dataclass(frozen=True, kw_only=True)
class StatsOptions(DatasetOptions, GateOptions):
    """Options of `unghost stats`."""


def stats(options: StatsOptions) -> None:
    """Count a dataset's boxes by verdict, reason, class, distance, map and weather.

    Conflicts are boxes that the filter keeps and a person rejects, or the reverse.
    Exit code 4 if a condition of --fail-if holds.
    """
    with options.connect() as client:
        numbers = client.stats(options.dataset)
        ghosts = client.report(options.dataset)
        refused = client.dataset(options.dataset).counts.problems
    # The frames of the report have addresses, and no counts that are not here.
    of_report = {k: v for k, v in ghosts.raw.items() if k != "worst_frames"}
    options.screen.record({**numbers.raw, "report": of_report})
    screen = options.screen
    totals = [(name.replace("_", " "), getattr(numbers, name)) for name in _TOTALS]
    screen.table(("dataset", "number"), totals)
    screen.table(_REASON_COLUMNS, _reasons(numbers), tag="reason")
    screen.table(_CLASS_COLUMNS, _classes(numbers), tag="class")
    screen.table(_BAND_COLUMNS, _bands(ghosts), tag="distance")
    for what, places, frames in (
        ("map", ghosts.by_map, numbers.by_map),
        ("weather", ghosts.by_weather, numbers.by_weather),
    ):
        columns = (what, "frames", *_BAND_COLUMNS[1:])
        rows = (
            (
                of.name or "not known",
                frames[of.name].frames if of.name else None,
                *_by_verdict(of),
            )
            for of in places
        )
        screen.table(columns, rows, tag=what)
    counts = gate_counts(numbers, refused)
    options.check(counts, options.screen, f"unghost stats {options.dataset}")


@dataclass(frozen=True, kw_only=True)
class ReportOptions(DatasetOptions):
    output: Annotated[
        Path, written_file("--output", "-o", metavar="FILE", help="The HTML file.")
    ]


def report(options: ReportOptions) -> None:
    """Write what is in a dataset as one HTML file: its ghosts, and what needs a person.

    The file opens from the disk, and can be printed and sent.
    """
    from filter_core.formats.files import write_whole
    from unghost.cli.inspect_page import document, section
    from unghost.cli.worth_page import Table, table_section

    with options.connect() as client:
        dataset = client.dataset(options.dataset)
        numbers = client.stats(options.dataset)
        ghosts = client.report(options.dataset)
        frames = ghosts.worst_frames[:_PICTURED]
        pictures = "".join(_pictured(client, frame) for frame in frames)
        evidence = client.evaluations(options.dataset)
        exports = list(islice(client.exports(options.dataset), _EXPORTS))
    kept = numbers.effective
    said = (
        f"{numbers.frames:,} frames, {numbers.boxes:,} boxes: {kept.kept:,} are "
        f"kept, {kept.rejected:,} are rejected, {kept.unmeasured:,} are not measured.",
        "A ghost is the box of an object that the camera cannot see. Decided by: "
        f"{dataset.evidence}.",
    )
    header = "".join(f"<p>{html.escape(text)}</p>" for text in said)
    left = [(_BINS[name], count) for name, count in numbers.bins.items()]
    tables = (
        Table("class", "By class", "", _CLASS_COLUMNS, list(_classes(numbers))),
        Table("distance", "By distance", "", _BAND_COLUMNS, list(_bands(ghosts))),
        Table("reason", "By cause", "", _REASON_COLUMNS, list(_reasons(numbers))),
        Table(
            "evidence",
            "Evidence",
            f"Each kind that was measured against the instance images: the truth about "
            f"{evidence.boxes:,} boxes is known. Recall is the share of the visible "
            "objects that are kept, precision that of the kept boxes that are visible.",
            _EVIDENCE_COLUMNS,
            [
                (
                    name,
                    score.judged,
                    *map(_share, (score.precision, score.recall, score.f1)),
                )
                for name, score in evidence.channels.items()
            ],
        ),
        Table("left", "What needs a person", "", _LEFT_COLUMNS, left),
        Table("export", "Exports", "", _EXPORT_COLUMNS, list(_exports(exports))),
    )
    page = document(
        html.escape(dataset.name),
        [
            f"<header>\n<h1>{html.escape(dataset.name)}</h1>\n{header}</header>",
            *(table_section(table) for table in tables if table.rows),
            section("The frames with the most ghosts", pictures),
        ],
    )
    write_whole(options.output, page.encode())
    options.screen.record(
        {"output": str(options.output), "boxes": numbers.boxes},
        f"{options.output}: {numbers.boxes:,} boxes",
    )


_PICTURED: Final = 6
"""Frames whose pictures are in a report."""
_EXPORTS: Final = 10
"""Of the exports, the newest so many are in a report."""
_EVIDENCE_COLUMNS: Final = ("evidence", "boxes measured", "precision", "recall", "F1")
_EXPORT_COLUMNS: Final = ("export", "format", "finished", "MB", "SHA-256")
_REASON_COLUMNS: Final = ("reason", "boxes", "%")
_LEFT_COLUMNS: Final = ("boxes without an answer", "number")
_BAND_COLUMNS: Final = ("metres", "boxes", "kept", "rejected", "unmeasured", "% kept")
_BINS: Final = {
    "ask": "to review: the filter may be wrong, and an eye can decide",
    "sure": "left to the filter, which is as good as certain",
    "small": "too small to decide by eye",
    "wall": "without a single pixel of their class",
}


def _bands(ghosts: Report) -> Iterator[tuple[object, ...]]:
    for band in ghosts.by_distance:
        if band.distance_from is None:
            name = "not known"
        elif band.distance_to is None:
            name = f"from {band.distance_from:g}"
        else:
            name = f"{band.distance_from:g}-{band.distance_to:g}"
        yield name, *_by_verdict(band)


def _share(measure: Measure | None) -> str | None:
    return None if measure is None else f"{100 * measure.value:.1f} %"


def _exports(exports: Sequence[Export]) -> Iterator[tuple[object, ...]]:
    for export in exports:
        if export.state != "done" or export.finished_at is None:
            continue
        size = None if export.size_bytes is None else round(export.size_bytes / 1e6, 1)
        name = export.name or str(export.id)
        yield (
            name,
            export.format,
            f"{export.finished_at:%Y-%m-%d %H:%M}",
            size,
            export.sha256,
        )


def _pictured(client: Client, frame: FrameSummary) -> str:
    """A frame as it came and as it is now; nothing if it has no picture."""
    if not frame.has_image:
        return ""
    name = html.escape(frame.key)
    parts = [f"<h3>{name}: {frame.counts.rejected:,} ghosts</h3>"]
    for boxes, words in (("kept,rejected,unmeasured", "before"), ("kept", "after")):
        data = base64.b64encode(client.overlay(frame.id, boxes=boxes)).decode()
        parts.append(
            f'<img style="max-width:100%" alt="{name}, {words}" '
            f'src="data:image/webp;base64,{data}">'
        )
    return "\n".join(parts)


def gate_counts(numbers: Stats, refused: int) -> dict[str, int]:
    """Frames and boxes of a dataset, for the conditions of `--fail-if`."""
    return {
        "frames": numbers.frames + refused,
        "refused": refused,
        "boxes": numbers.boxes,
        "kept": numbers.kept,
        "rejected": numbers.rejected,
        "unmeasured": numbers.unmeasured,
        "unmapped": numbers.by_reason.get("unmapped_class", 0),
    }


def _reasons(numbers: Stats) -> Iterator[tuple[object, ...]]:
    for reason, count in most_first(numbers.by_reason):
        yield reason, count, _percent(count, numbers.boxes)


def _classes(numbers: Stats) -> Iterator[tuple[object, ...]]:
    for name, counts in numbers.by_class.items():
        yield name, *_by_verdict(counts)


def _by_verdict(of: VerdictCounts) -> tuple[object, ...]:
    """The boxes, those of each verdict, and the percentage of those that are kept."""
    boxes = of.kept + of.rejected + of.unmeasured
    return boxes, of.kept, of.rejected, of.unmeasured, _percent(of.kept, boxes)


def _percent(part: int, whole: int) -> float | None:
    return round(100 * part / whole, 1) if whole else None
