"""`unghost convert`: labels from one format into another, without a server."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from unghost.cli.command import command
from unghost.cli.exits import PARTLY, REFUSED
from unghost.cli.format_options import FORMATS_HELP, FormatOptions
from unghost.cli.options import OutputOptions
from unghost.cli.screen import Screen
from unghost.cli.source_options import SegmentationReading, SourceOptions
from unghost.cli.sources import open_source, read_config

if TYPE_CHECKING:
    from filter_core.formats.export import ExportFrame, ExportOptions
    from filter_core.formats.reading import FrameSet
    from filter_core.local import LeftOut


@dataclass(frozen=True, kw_only=True)
class ConvertOptions(OutputOptions, SourceOptions, SegmentationReading, FormatOptions):
    """Options of `unghost convert`."""

    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A folder in a recognised layout, a manifest.jsonl, or COCO's .json.",
            exists=True,
        ),
    ]
    to: Annotated[str, typer.Option("--to", metavar="FORMAT", help=FORMATS_HELP)]
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="The folder to make.", file_okay=False),
    ]
    filter: Annotated[
        bool,
        typer.Option(
            "--filter",
            help="Decide every box by the segmentations, and leave out what is "
            "rejected; else every box is taken over.",
        ),
    ] = False
    config: Annotated[
        Path | None,
        typer.Option(
            help="A filter configuration (YAML) for --filter; else the defaults.",
            exists=True,
            dir_okay=False,
        ),
    ] = None


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "convert")(convert)


def convert(options: ConvertOptions) -> None:
    """Write the labels of a folder in another format, without a server.

    With --filter, only the boxes that the filter keeps. The new folder appears when
    all of it is written; its manifest.json names every box that was left out or cut.
    Exit code 3 if some frames could not be read or matched; they are listed.
    """
    if options.config is not None and not options.filter:
        raise typer.BadParameter("--config is for --filter")
    from filter_core.formats.registry import format_of

    format_of(options.to, _wanted(options))
    found = open_source(options.source, options)
    coming = _Coming(options.screen)
    counts = _write(options, found, coming)
    for file in found.unmatched:
        coming.screen.note(f"not matched: {file.path}: {file.why}")
    _print(options, coming, counts)
    if coming.failed or found.unmatched:
        raise typer.Exit(PARTLY if coming.written else REFUSED)


def _wanted(options: ConvertOptions) -> ExportOptions:
    from filter_core.formats.export import ExportOptions

    # Without the filter nothing is decided, and so nothing is left out.
    taken_over = not options.filter and not options.to.startswith("decisions")
    include = {"include": "all"} if taken_over else {}
    return ExportOptions.from_mapping({**include, **options.given})


def _write(
    options: ConvertOptions, found: FrameSet, coming: _Coming
) -> Mapping[str, Any]:
    from filter_core.formats.export import ExportHead
    from filter_core.formats.files import folder_sink
    from filter_core.formats.registry import write_export
    from filter_core.local import class_order, export_sources

    config = read_config(options.config, options, options.screen)
    classes = found.classes or class_order(found)
    coming.screen.note(f"classes in this order: {', '.join(classes)}")
    decided = {"config": config.digest} if options.filter else {}
    facts = {"source": options.source.name, "layout": found.layout, **decided}
    frames = export_sources(found, config, measure=options.filter)
    with folder_sink(options.output) as sink:
        return write_export(
            options.to,
            coming.watch(frames, found.count),
            sink,
            ExportHead(classes, facts),
            _wanted(options),
        )


class _Coming:
    """Frames on their way: passes on those that can be written, lists the others."""

    def __init__(self, screen: Screen) -> None:
        self.screen = screen
        self.written = 0
        self.failed = 0

    def watch(
        self, frames: Iterable[ExportFrame | LeftOut], total: int | None
    ) -> Iterator[ExportFrame]:
        """The frames to be written, under a bar."""
        from filter_core.formats.export import ExportFrame

        with self.screen.progress("convert", "frames") as advance:
            for frame in frames:
                if isinstance(frame, ExportFrame):
                    self.written += 1
                    yield frame
                else:
                    self.failed += 1
                    self.screen.note(f"refused: {frame.key}: {frame.problem.detail}")
                advance(self.written + self.failed, total)


def _print(options: ConvertOptions, coming: _Coming, counts: Mapping[str, Any]) -> None:
    boxes = {name: counts["boxes"][name] for name in ("in", "out", "dropped")}
    record = {"frames": coming.written, "failed": coming.failed, "boxes": boxes}
    text = (
        f"{options.output}\t{coming.written} frames\t{boxes['out']} of {boxes['in']} "
        "boxes"
    )
    options.screen.record({"output": str(options.output), **record}, text)
