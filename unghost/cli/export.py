"""Labels as files: `unghost export` from a server, `unghost convert` without one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from unghost.cli.options import DatasetOptions, OutputOptions, listed
from unghost.cli.runs import cancel_interrupted
from unghost.cli.screen import (
    PARTLY,
    ImageNotes,
    Kinds,
    Refused,
    Screen,
    naming_options,
    partly_done,
    refusal,
)
from unghost.cli.sources import (
    FrameCheck,
    SourceOptions,
    default_class_of,
    kind_of,
    naming_reading,
    open_source,
    read_config,
    reads_archives,
    shown_by,
    unmatched_lines,
)
from unghost.cli.summary import (
    LOOKED_AT,
    Advice,
    BoxSummary,
    UnmappedOptions,
    summary_of,
    unmapped_names,
)
from unghost.wire.words import ExportFormat

if TYPE_CHECKING:
    from filter_core.config.filter import FilterConfig
    from filter_core.formats.export import ExportFrame
    from filter_core.formats.export import ExportOptions as LabelOptions
    from filter_core.formats.reading import FrameSet
    from filter_core.formats.tally import Counts
    from filter_core.local import ClassCount, LeftOut
    from unghost.client.client import Client
    from unghost.wire import Export


_LISTS: Final = ("bands",)
"""Options that take several values, separated by commas."""

_OPTION_OF_FIELD: Final = {"/format": "--format", "/options/": "--option "}


@dataclass(frozen=True, kw_only=True)
class FormatOptions:
    """How to write a format."""

    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option",
            "-O",
            metavar="KEY=VALUE",
            help="An option of the format, such as include=all, split=0.9 or "
            "bands=50,100. split says about which share of the frames is "
            "for training. A hash of a frame's key decides whether the frame is, which "
            "does not change when others are added.",
        ),
    ] = None
    allow_missing_images: Annotated[
        bool,
        typer.Option(
            "--allow-missing-images",
            help="Also write frames without an image. Otherwise formats of labels "
            "leave them out, because many programs cannot read such labels.",
        ),
    ] = False

    @property
    def given(self) -> dict[str, object]:
        """The options by name.

        Raises
        ------
        typer.BadParameter
            One is not of the form KEY=VALUE, is given twice, or is no format's option.
        """
        from unghost.wire.runs import ExportOptions as KnownOptions

        known = KnownOptions.model_fields
        found: dict[str, object] = {}
        for key, value in map(_pair, self.option or ()):
            if key not in known:
                raise typer.BadParameter(
                    f"--option {key}: expected one of {', '.join(known)}"
                )
            if key in found:
                raise typer.BadParameter(f"--option {key} is given twice")
            found[key] = value
        if self.allow_missing_images:
            found["allow_missing_images"] = True
        return found


def _pair(text: str) -> tuple[str, object]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise typer.BadParameter(f"--option {text!r} is not of the form KEY=VALUE")
    if key in _LISTS:
        return key, [_value(part.strip()) for part in value.split(",") if part.strip()]
    return key, _value(value)


def _value(text: str) -> object:
    """A number or a truth value where it reads like one, as in YAML."""
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text) if "." in text else int(text)
    except ValueError:
        return text


@dataclass(frozen=True, kw_only=True)
class ExportOptions(DatasetOptions, FormatOptions):
    """Options of `unghost export`."""

    format: Annotated[
        ExportFormat,
        typer.Option("--format", metavar="FORMAT", help=f"{listed(ExportFormat)}."),
    ]
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The file to write.", dir_okay=False)
    ]


def export(options: ExportOptions) -> None:
    """Have the server write the labels of a dataset, and download them.

    An interrupted download continues where it stopped: equal labels give equal files.
    The first export in a format with class numbers (YOLO, COCO) freezes the dataset's
    classes for good, also if there is no frame: later frames with other classes are
    refused, and no class can be renamed.
    Exit code 3 if a class is unknown, or all boxes of a class are rejected.
    """
    screen = options.screen
    with options.connect() as client:
        given = {f"--option {name}": value for name, value in options.given.items()}
        before = client.dataset(options.dataset)
        with naming_options(_OPTION_OF_FIELD, given):
            started = client.start_export(
                options.dataset, options.format, **options.given
            )
        screen.note(f"export {started.id} of {options.dataset} ({options.format})")
        if client.dataset(options.dataset).classes_frozen > before.classes_frozen:
            screen.note(
                f"the classes of {options.dataset} are frozen from now on: frames with "
                "other classes are refused"
            )
        done = wait_for_export(client, started, screen)
        _download(client, done, options)
        summary = summary_of(client, options.dataset)
    if counted := _boxes_written(done):
        screen.note(counted)
    _left_out(done.counts or {}, screen)
    is_doubtful = summary.note(screen)
    screen.record({**done.raw, "path": str(options.output)}, str(options.output))
    if is_doubtful:
        raise typer.Exit(PARTLY)


def wait_for_export(client: Client, export: Export, screen: Screen) -> Export:
    """Wait until an export is done, with a progress bar.

    If the command is interrupted, the export is cancelled.

    Raises
    ------
    RunFailed
        It did not succeed.
    """
    try:
        with screen.progress(f"export {export.id}", "frames") as advance:
            return client.wait_for_export(
                export, progress=lambda state: advance(state.done, state.total)
            )
    except KeyboardInterrupt:
        outcome = cancel_interrupted(
            f"export {export.id}", lambda: client.cancel_export(export)
        )
        raise KeyboardInterrupt(
            f"interrupted; {outcome}; the same command creates another"
        ) from None


def _left_out(counts: Mapping[str, object], screen: Screen) -> int:
    """How many frames were left out because they have no image; noted if any."""
    frames = counts.get("frames")
    count = int(frames.get("left_out", 0)) if isinstance(frames, Mapping) else 0
    if count:
        screen.note(
            f"left out: {count:,} frames without an image; --allow-missing-images "
            "writes them, too"
        )
    return count


def _boxes_written(done: Export) -> str:
    """How many boxes were written, and what became of the rest; empty if not known."""
    counts = done.counts or {}
    boxes = counts.get("boxes", {})
    if "in" not in boxes or "out" not in boxes:
        return ""
    fates = {"to be ignored": boxes.get("dontcare"), "left out": boxes.get("dropped")}
    others = [f"{count} {fate}" for fate, count in fates.items() if count]
    text = ", ".join([f"{boxes['out']} of {boxes['in']} boxes written", *others])
    reasons = counts.get("not_kept_by_reason", {})
    why = ", ".join(f"{reason} {count}" for reason, count in reasons.items())
    unmeasured = unmeasured_text(counts.get("unmeasured", {}))
    parts = (text, unmeasured, f"reasons: {why}" if why else "")
    return "; ".join(part for part in parts if part)


def unmeasured_text(unmeasured: Mapping[str, object]) -> str:
    """What became of the unmeasured boxes, by their counts; empty without any."""
    if frames := unmeasured.get("frames_left_out"):
        boxes = unmeasured["left_out"]
        return f"{frames} frames left out with their {boxes} unmeasured boxes"
    if written := unmeasured.get("written"):
        return f"{written} unmeasured boxes written as they came"
    return ""


def _download(client: Client, done: Export, options: ExportOptions) -> None:
    try:
        with options.screen.progress("download", "kB") as advance:
            client.download(
                done,
                options.output,
                progress=lambda have, size: advance(_kb(have), size and _kb(size)),
            )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted; the same command continues {options.output}"
        ) from None


def _kb(size_bytes: int) -> int:
    # Rounded up: the last one is reached with the last byte.
    return -(-size_bytes // 1000)


@dataclass(frozen=True, kw_only=True)
class ConvertOptions(OutputOptions, SourceOptions, FormatOptions, UnmappedOptions):
    """Options of `unghost convert`."""

    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A folder in one of the known layouts, a manifest.jsonl, a COCO "
            ".json, or an archive of a folder (.zip, .tar, .tar.gz).",
            exists=True,
        ),
    ]
    to: Annotated[
        ExportFormat,
        typer.Option("--to", metavar="FORMAT", help=f"{listed(ExportFormat)}."),
    ]
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="The folder to create.", file_okay=False),
    ]
    filter: Annotated[
        bool,
        typer.Option(
            "--filter",
            help="Decide every box by the segmentations and leave out those that are "
            "rejected; those that could not be measured are written. Without it, every "
            "box is written.",
        ),
    ] = False
    config: Annotated[
        Path | None,
        typer.Option(
            help="A filter configuration (YAML) for --filter; default: the built-in "
            "one.",
            exists=True,
            dir_okay=False,
        ),
    ] = None


@reads_archives
def convert(options: ConvertOptions) -> None:
    """Write the labels of a folder in another format, without a server.

    With --filter, the boxes that the filter keeps, and those that could not be measured
    as they came (-O include_unmeasured=false leaves out their frames). The new folder
    appears when it is complete; its manifest.json names every box that was left out or
    cut.
    Exit code 3 if some frames could not be read or matched; they are listed. With
    --filter, also if a class or pixels in boxes are unknown, or all boxes of a class
    are rejected.
    """
    if not options.filter:
        given = ["config"] if options.config is not None else []
        if names := [*given, *options.reading]:
            option = names[0].replace("_", "-")
            raise typer.BadParameter(f"--{option} is for --filter")
    # Before the folder is read, which may take long: this refuses an unknown format.
    labels = _label_options(options)
    description = options.describe(options.source)
    found = open_source(options.source, options.layout, description)
    default_class = default_class_of(found, description)
    progress = _Progress(
        options.screen, BoxSummary(Advice(default_class, " and written as they came"))
    )
    config = read_config(options.config, options, description, options.screen)
    counts = _write_labels(options, labels, found, config, progress)
    progress.notes.print(options.screen)
    is_doubtful = options.filter and progress.summary.note(options.screen)
    progress.check.note(options.screen, found)
    for line in (*progress.refusals.more(), *unmatched_lines(found.unmatched)):
        options.screen.note(line)
    boxes = {name: counts["boxes"][name] for name in ("in", "out", "dropped")}
    unmeasured = counts.get("unmeasured", {})
    if said := unmeasured_text(unmeasured):
        options.screen.note(said)
    frames_out = unmeasured.get("frames_left_out", 0)
    assert isinstance(frames_out, int)
    written = progress.written - frames_out - _left_out(counts, options.screen)
    frames = {"frames": written, "failed": progress.failed}
    options.screen.record(
        {
            "output": str(options.output),
            **frames,
            "boxes": boxes,
            **({"unmeasured": unmeasured} if unmeasured else {}),
        },
        f"{options.output}\t{written} frames\t{boxes['out']} of {boxes['in']} boxes",
    )
    if progress.failed or found.unmatched or is_doubtful:
        raise partly_done(progress.written)


def _label_options(options: ConvertOptions) -> LabelOptions:
    """The options of the format.

    Raises
    ------
    typer.BadParameter
        The format has no such option, or the option no such value.
    NotAvailable
        The format needs a library that is not installed.
    """
    from filter_core.formats.export import ExportError
    from filter_core.formats.export import ExportOptions as LabelOptions
    from filter_core.formats.registry import format_of

    try:
        given = LabelOptions.from_mapping(options.given)
        selects_boxes = "include" in format_of(options.to, given).options
    except ExportError as exc:
        name = exc.pointer.removeprefix("/options/")
        why = exc.detail.removeprefix(f"{name}: ")
        raise typer.BadParameter(f"--option {name}: {why}") from exc
    if options.filter or not selects_boxes:
        return given
    # Without the filter nothing is decided, and so nothing is left out.
    return LabelOptions.from_mapping({"include": "all", **options.given})


def _write_labels(
    options: ConvertOptions,
    labels: LabelOptions,
    found: FrameSet,
    config: FilterConfig,
    progress: _Progress,
) -> Counts:
    from filter_core.formats.export import ExportHead
    from filter_core.formats.files import folder_sink
    from filter_core.formats.reading import name_of
    from filter_core.formats.registry import format_of, write_export
    from filter_core.local import (
        boxes_by_class,
        export_sources,
        in_class_order,
    )

    boxes: Counter[str] = Counter()
    may_be_unmapped = options.filter and unmapped_names(found.classes or (), config)
    if not found.classes or may_be_unmapped:
        boxes = boxes_by_class(found)
    classes = found.classes or in_class_order(boxes)
    if options.filter:
        options.require_known(boxes, config, progress.summary.advice)
        first = islice(found, LOOKED_AT)
        found = shown_by(first, config, config.channels, options.screen).of(found)
    options.screen.note(f"classes in this order: {', '.join(classes)}")
    decided = {"config": config.digest} if options.filter else {}
    facts = {"source": name_of(options.source), "layout": found.layout, **decided}
    needs = format_of(options.to, labels).needs
    frames = export_sources(
        progress.check.watch(found),
        config,
        measure=options.filter,
        needs=needs,
        also=progress.add,
    )
    with folder_sink(options.output) as sink:
        counts = write_export(
            options.to,
            progress.watch(frames, found.count),
            sink,
            ExportHead(classes, facts),
            labels,
        )
        if not progress.written:  # and so the folder does not appear
            for line in progress.refusals.more():
                options.screen.note(line)
            raise Refused(f"no frame can be read ({progress.failed} refused)")
        return counts


class _Progress:
    """Passes on the frames that can be written, counts them, and lists the others."""

    def __init__(self, screen: Screen, summary: BoxSummary) -> None:
        self.screen = screen
        self.summary = summary
        self.notes = ImageNotes()
        self.written = 0
        self.failed = 0
        self.refusals = Kinds()
        self.check = FrameCheck()

    def add(self, classes: Mapping[str, ClassCount], notes: Iterable[str]) -> None:
        """The boxes of one frame by class, and how its images were read."""
        self.summary.add(classes)
        self.notes.add(notes)

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
                    if self.refusals.is_listed(kind_of(frame.problem)):
                        why = naming_reading(frame.problem.detail)
                        self.screen.note(refusal(frame.key, why))
                advance(self.written + self.failed, total)
