"""Labels as files: `unghost export` from a server, `unghost convert` without one."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from shutil import copyfileobj
from typing import TYPE_CHECKING, Annotated, Any, Final
from zipfile import ZipFile

import typer

from unghost.cli import sources
from unghost.cli.options import (
    DatasetOptions,
    OutputOptions,
    listed,
    read_file,
    written_file,
)
from unghost.cli.remote.runs import cancel_interrupted
from unghost.cli.screen import (
    PARTLY,
    ImageNotes,
    Kinds,
    Refused,
    Screen,
    naming_options,
    one_line,
    partly_done,
    refusal,
)
from unghost.cli.summary import (
    LOOKED_AT,
    UnmappedOptions,
    note_boxes,
    summary_of,
    unmapped_names,
)
from unghost.wire.words import ConvertFormat, ExportFormat

if TYPE_CHECKING:
    from filter_core.config.filter import FilterConfig
    from filter_core.formats.export import ExportFrame
    from filter_core.formats.export import ExportOptions as LabelOptions
    from filter_core.formats.reading import FrameSet
    from filter_core.formats.same import BoxSpans, LeftBehind
    from filter_core.formats.tally import Counts
    from filter_core.inspection.remarks import BoxSummary
    from filter_core.local import ClassCount, FrameOutcome, LeftOut
    from unghost.client.client import Client
    from unghost.wire import Export


_LISTS: Final = ("bands", "split")
"""Options that take several values, separated by commas."""

_TABLES: Final = {
    "decisions-csv": "decisions.csv",
    "decisions-jsonl": "decisions.jsonl",
    "decisions-parquet": "decisions.parquet",
}
"""Of each format that is one table, its file in the archive of an export."""

_OPTION_OF_FIELD: Final = {
    "/format": "--format",
    **{f"/options/split/{place}": "--option split" for place in range(3)},
    "/options/": "--option ",
}


@dataclass(frozen=True, kw_only=True)
class FormatOptions:
    """How to write a format."""

    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option",
            "-O",
            metavar="KEY=VALUE",
            help="An option of the format, such as include=all or bands=50,100.",
        ),
    ] = None
    split: Annotated[
        str | None,
        typer.Option(
            metavar="SHARES",
            help="Make other parts: their shares for train, val and test, such as "
            "0.8,0.1,0.1. Whole sequences (the drives that keys of frames begin with) "
            "go into a part, which does not change when others are added. Default: "
            "frames keep the parts they came with, and of those without one 80 % are "
            "for training.",
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

        Raises `typer.BadParameter`: one is not of the form KEY=VALUE, is given twice,
        or is no format's option.
        """
        from unghost.wire.runs import ExportOptions as KnownOptions

        fields = KnownOptions.model_fields
        options: dict[str, object] = {}
        for key, value in map(_pair, self.option or ()):
            if key not in fields:
                raise typer.BadParameter(
                    f"--option {key}: expected one of {', '.join(fields)}"
                )
            if key in options:
                raise typer.BadParameter(f"--option {key} is given twice")
            options[key] = value
        if self.split is not None:
            if "split" in options:
                raise typer.BadParameter("--option split is given twice")
            options["split"] = _pair(f"split={self.split}")[1]
        if self.allow_missing_images:
            options["allow_missing_images"] = True
        return options


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
    format: Annotated[
        ExportFormat | None,
        typer.Option(metavar="FORMAT", help=f"{listed(ExportFormat)}."),
    ] = None
    name: Annotated[
        str | None,
        typer.Option(
            metavar="VERSION",
            help="Name the export: it is kept as a version of the dataset.",
        ),
    ] = None
    since: Annotated[
        str | None,
        typer.Option(
            metavar="VERSION",
            help="Write only frames that are new or have changed since this version.",
        ),
    ] = None
    version: Annotated[
        str | None,
        typer.Option(
            metavar="VERSION",
            help="Write a version again, byte for byte, instead of a new export.",
        ),
    ] = None
    output: Annotated[
        Path,
        written_file(
            "--output",
            "-o",
            help="The file to write: a ZIP archive. Decisions are written as one file "
            "(CSV, JSON lines, Parquet), unless the name ends in .zip.",
        ),
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
    if options.version is not None:
        _write_again(options, options.version)
        return
    if options.format is None:
        raise typer.BadParameter("expected --format, or --version of an earlier export")
    with options.connect() as client:
        values = {f"--option {name}": value for name, value in options.given.items()}
        before = client.dataset(options.dataset)
        with naming_options(_OPTION_OF_FIELD, values):
            asked = options.given.get("split")
            shares = asked if isinstance(asked, list) else []
            # Others are refused as options of the export.
            are_shares = all(
                isinstance(share, int | float) and 0 <= share <= 1 for share in shares
            )
            by_map = options.given.get("split_by") == "map"
            if shares and are_shares and not by_map:
                parts = client.parts(options.dataset, shares)
                screen.note(_planned_text(parts.frames, shares))
            chosen: dict[str, Any] = options.given
            started = client.start_export(
                options.dataset,
                options.format,
                name=options.name,
                since=options.since,
                **chosen,
            )
        screen.note(f"export {started.id} of {options.dataset} ({options.format})")
        if client.dataset(options.dataset).classes_frozen > before.classes_frozen:
            screen.note(
                f"the classes of {options.dataset} are frozen from now on: frames with "
                "other classes are refused"
            )
        done = wait_for_export(client, started, screen)
        _fetch(client, done, options)
        summary = summary_of(client, options.dataset)
    if counted := _boxes_written(done):
        screen.note(counted)
    if of_parts := parts_text(done.counts or {}):
        screen.note(of_parts)
    _left_out(done.counts or {}, screen)
    is_doubtful = note_boxes(screen, summary)
    screen.record({**done.raw, "path": str(options.output)}, str(options.output))
    if is_doubtful:
        raise typer.Exit(PARTLY)


def _write_again(options: ExportOptions, name: str) -> None:
    """Download the file of a version."""
    with options.connect() as client:
        versions = client.versions(options.dataset)
        by_name = {
            version.name: version for version in versions if version.state == "done"
        }
        if name not in by_name:
            listed = ", ".join(map(str, by_name)) or "none"
            raise Refused(f"--version: expected one of {listed}; found {name!r}")
        export = by_name[name]
        if options.format not in (None, export.format):
            raise Refused(
                f"version {name!r} has the format {export.format}, found --format "
                f"{options.format}: leave it out"
            )
        _fetch(client, export, replace(options, format=export.format))
    options.screen.record(
        {**export.raw, "path": str(options.output)}, str(options.output)
    )


def versions(options: DatasetOptions) -> None:
    """List the versions of a dataset: exports that have a name, newest first."""
    with options.connect() as client:
        options.screen.listing(
            ("version", "digest", "format", "frames", "made", "by", "since"),
            client.versions(options.dataset),
            lambda version: (
                version.name,
                (version.version or version.state)[:12],
                version.format,
                version.total,
                version.created_at.isoformat(sep=" ", timespec="minutes"),
                version.created_by,
                version.since,
            ),
        )


def wait_for_export(client: Client, export: Export, screen: Screen) -> Export:
    """Wait until an export is done, with a progress bar.

    If the command is interrupted, the export is cancelled.

    Raises `RunFailed`: it did not succeed.
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


_NO_PARTS: Final = ("in", "without_boxes", "without_image", "left_out")
"""What is counted of frames besides those of each part."""

_TOLD: Final = {
    "as_it_came": "have the part they came with",
    "by_sequence": "are split by whole sequences",
    "by_map": "are split by their maps",
    "without_sequence": "are split one by one, since nothing tells their sequence; "
    "`sequence` in their annotations names it",
    "by_frame": "are split one by one, since nothing tells their part; --split 0.8,0.2 "
    "keeps sequences together",
}


def parts_text(counts: Mapping[str, object]) -> str:
    """How many frames went to each part, and what told it; empty if that is unknown."""
    frames, told, sequences = (
        some if isinstance(some, Mapping) else {}
        for some in map(counts.get, ("frames", "split", "sequences"))
    )
    parts = {name: n for name, n in frames.items() if name not in _NO_PARTS}
    if not told or not parts:
        return ""
    total = sum(parts.values())
    of_parts = [
        f"{name} {count:,} ({count / total:.0%})" for name, count in parts.items()
    ]
    of_sequences = [f"{name} {count:,}" for name, count in sequences.items()]
    said = [
        f"parts: {', '.join(of_parts)}",
        *([f"sequences: {', '.join(of_sequences)}"] if of_sequences else []),
        *(f"{told[how]:,} frames {why}" for how, why in _TOLD.items() if how in told),
    ]
    return "; ".join(said)


def _planned_text(frames: Mapping[str, int], asked: Sequence[float]) -> str:
    """The shares of parts that are asked for, and the frames that they get."""
    from filter_core.formats.splits import shares_of

    total = max(1, sum(frames.values()))
    of_parts = (
        f"{part} {share:.0%}: {frames.get(part, 0):,} "
        f"({frames.get(part, 0) / total:.0%})"
        for part, share in shares_of(asked).items()
    )
    return f"asked for {', '.join(of_parts)} of the frames"


def unmeasured_text(unmeasured: Mapping[str, object]) -> str:
    """What became of the unmeasured boxes, by their counts; empty without any."""
    if frames := unmeasured.get("frames_left_out"):
        boxes = unmeasured["left_out"]
        return f"{frames} frames left out with their {boxes} unmeasured boxes"
    if written := unmeasured.get("written"):
        return f"{written} unmeasured boxes written as they came"
    return ""


def _fetch(client: Client, done: Export, options: ExportOptions) -> None:
    """Download the archive, or of a format that is one table, this table."""
    output, table = options.output, _TABLES.get(options.format or "")
    if table is None or output.suffix.lower() == ".zip":
        _download(client, done, options, output)
        return
    # Beside it and with the digest in its name, so that a repeated command continues.
    archive = output.with_name(f".{output.name}.{(done.sha256 or '')[:12]}.zip")
    partial = output.with_name(f"{output.name}.part")
    _download(client, done, options, archive)
    partial.unlink(missing_ok=True)
    with (
        ZipFile(archive) as opened,
        opened.open(table) as source,
        partial.open("xb") as target,
    ):
        copyfileobj(source, target)
    partial.replace(output)
    archive.unlink()


def _download(client: Client, done: Export, options: ExportOptions, path: Path) -> None:
    try:
        with options.screen.progress("download", "kB") as advance:
            client.download(
                done,
                path,
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
class ConvertOptions(
    OutputOptions, sources.SourceOptions, FormatOptions, UnmappedOptions
):
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
        ConvertFormat,
        typer.Option(
            metavar="FORMAT", help=f"{listed(ConvertFormat)}, which is that of SOURCE."
        ),
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
        read_file(
            help="A filter configuration (YAML) for --filter; default: the built-in "
            "one."
        ),
    ] = None


@sources.reads_archives
def convert(options: ConvertOptions) -> None:
    """Write the labels of a folder in another format or the same, without a server.

    With --filter, the boxes that the filter keeps, and those that could not be measured
    as they came (-O include_unmeasured=false leaves out their frames). The new folder
    appears when it is complete; its manifest.json names every box that was left out or
    cut.
    In the same format, the folder is copied as it is, and only the bytes of rejected
    boxes are left out of its labels; images are linked where that is possible. Any -O
    writes new labels instead.
    Exit code 3 if some frames could not be read or matched; they are listed. With
    --filter, also if a class or pixels in boxes are unknown, or all boxes of a class
    are rejected.
    """
    from filter_core.formats.registry import format_of
    from filter_core.inspection.remarks import BoxSummary, RecordingAdvice

    if not options.filter:
        config_names = ["config"] if options.config is not None else []
        if names := [*config_names, *options.reading]:
            option = names[0].replace("_", "-")
            raise typer.BadParameter(f"--{option} is for --filter")
    # Before the folder is read, which may take long: this refuses an unknown format.
    labels = None if options.to == "same" else _label_options(options)
    description = options.description_of(options.source)
    source_frames = sources.open_source(options.source, options.layout, description)
    default_class = sources.default_class_of(source_frames, description)
    advice = RecordingAdvice(default_class, " and written as they came")
    progress = _Progress(options.screen, BoxSummary(advice))
    config = sources.read_config(options.config, options, description, options.screen)
    if labels is None or (options.to == source_frames.layout and not options.option):
        _convert_same(options, source_frames, config, progress)
        return
    counts = _write_labels(options, labels, source_frames, config, progress)
    progress.notes.print(options.screen)
    is_doubtful = options.filter and note_boxes(options.screen, progress.summary)
    progress.note_unread(source_frames)
    boxes = {name: counts["boxes"][name] for name in ("in", "out", "dropped")}
    if "split" in format_of(options.to, labels).options:
        options.screen.note(parts_text(counts))
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
    if progress.failed or source_frames.unmatched or is_doubtful:
        raise partly_done(progress.written)


def _label_options(options: ConvertOptions) -> LabelOptions:
    """The options of the format."""
    from filter_core.formats.export import ExportError
    from filter_core.formats.export import ExportOptions as LabelOptions
    from filter_core.formats.registry import format_of

    try:
        labels = LabelOptions.from_mapping(options.given)
        selects_boxes = "include" in format_of(options.to, labels).options
    except ExportError as exc:
        name = exc.pointer.removeprefix("/options/")
        why = exc.detail.removeprefix(f"{name}: ")
        raise typer.BadParameter(f"--option {name}: {why}") from exc
    if options.filter or not selects_boxes:
        return labels
    # Without the filter nothing is decided, and so nothing is left out.
    return LabelOptions.from_mapping({"include": "all", **options.given})


def _write_labels(
    options: ConvertOptions,
    labels: LabelOptions,
    source_frames: FrameSet,
    config: FilterConfig,
    progress: _Progress,
) -> Counts:
    from filter_core.formats.export import ExportHead
    from filter_core.formats.files import folder_sink
    from filter_core.formats.reading import name_of
    from filter_core.formats.registry import format_of, write_export
    from filter_core.formats.splits import part_by_shares, shares_of
    from filter_core.local import class_order, export_sources
    from filter_core.values import as_text

    classes = source_frames.classes or class_order(source_frames)
    if options.filter:
        source_frames = _as_shown(options, source_frames, config, progress)
    options.screen.note(f"classes in this order: {', '.join(classes)}")
    if labels.split and labels.split_by == "sequence":
        shares = shares_of(labels.split)
        said = ((frame.key, frame.annotation or {}) for frame in source_frames)
        parts = Counter(
            part_by_shares(
                key,
                as_text(annotation.get("map")),
                as_text(annotation.get("sequence")),
                shares,
            )
            for key, annotation in said
        )
        options.screen.note(_planned_text(parts, labels.split))
    decided = {"config": config.digest} if options.filter else {}
    facts = {
        "source": name_of(options.source),
        "layout": source_frames.layout,
        **decided,
    }
    needs = format_of(options.to, labels).needs
    frames = export_sources(
        progress.check.watch(source_frames),
        config,
        measure=options.filter,
        needs=needs,
        also=progress.add,
    )
    with folder_sink(options.output) as sink:
        counts = write_export(
            options.to,
            progress.watch(frames, source_frames.count),
            sink,
            ExportHead(classes, facts),
            labels,
        )
        progress.require_frames()  # else the folder does not appear
        return counts


def _as_shown(
    options: ConvertOptions, frames: FrameSet, config: FilterConfig, progress: _Progress
) -> FrameSet:
    """The frames to be filtered, read as their images show; refuses unknown classes."""
    from filter_core.local import boxes_by_class

    boxes: Counter[str] = Counter()
    if not frames.classes or unmapped_names(frames.classes, config):
        boxes = boxes_by_class(frames)
    options.require_known(boxes, config, progress.summary.advice)
    first = islice(frames, LOOKED_AT)
    return sources.shown_by(first, config, config.channels, options.screen).of(frames)


def _convert_same(
    options: ConvertOptions,
    source_frames: FrameSet,
    config: FilterConfig,
    progress: _Progress,
) -> None:
    """Copy the folder without the boxes that are rejected, and say which these are."""
    from filter_core.formats.files import new_folder
    from filter_core.formats.same import RecordingCopy
    from filter_core.local import outcomes

    screen = options.screen
    copy = RecordingCopy(options.source, _box_spans(options, source_frames))
    _require_apart(options, copy.folder)
    if options.filter:
        source_frames = _as_shown(options, source_frames, config, progress)
    removed: dict[str, Counter[str]] = defaultdict(Counter)
    boxes: Counter[str] = Counter()
    frames = progress.check.watch(source_frames)
    with new_folder(options.output) as folder:
        with screen.progress("convert", "frames") as advance:
            for frame, outcome in outcomes(frames, config if options.filter else None):
                progress.add_outcome(outcome)
                advance(progress.written + progress.failed, source_frames.count)
                if outcome.error is not None:
                    copy.add(frame)
                    continue
                decisions = outcome.decisions or []
                annotated = (frame.annotation or {}).get("boxes")
                boxes["in"] += len(annotated) if isinstance(annotated, Sequence) else 0
                verdicts = [decision["verdict"] for decision in decisions]
                boxes["unmeasured"] += verdicts.count("unmeasured")
                rows = [
                    row for row, verdict in enumerate(verdicts) if verdict == "rejected"
                ]
                for decision in map(decisions.__getitem__, rows):
                    removed[decision["class"]][decision["reason"]] += 1
                copy.add(frame, rows)
        progress.require_frames()
        left = copy.write(folder)
    _note_copy(options, source_frames, progress, left)
    dropped = sum(map(Counter.total, removed.values()))
    if dropped:
        why = {
            name: ", ".join(
                f"{reason} {count}" for reason, count in reasons.most_common()
            )
            for name, reasons in removed.items()
        }
        names = sorted(removed, key=lambda name: -removed[name].total())
        named = (f"{name} {removed[name].total()} ({why[name]})" for name in names)
        screen.note(one_line(f"taken away: {', '.join(named)}"))
    if boxes["unmeasured"]:
        screen.note(unmeasured_text({"written": boxes["unmeasured"]}))
    is_doubtful = options.filter and note_boxes(screen, progress.summary)
    out = boxes["in"] - dropped
    counts = {"in": boxes["in"], "out": out, "dropped": dropped}
    unmeasured = {"written": boxes["unmeasured"]} if boxes["unmeasured"] else {}
    screen.record(
        {
            "output": str(options.output),
            "frames": progress.written,
            "failed": progress.failed,
            "boxes": counts,
            **({"unmeasured": unmeasured} if unmeasured else {}),
            "taken_away": {
                name: dict(reasons) for name, reasons in sorted(removed.items())
            },
        },
        f"{options.output}\t{progress.written} frames\t{out} of {boxes['in']} boxes",
    )
    if progress.failed or source_frames.unmatched or is_doubtful:
        raise partly_done(progress.written)


def _box_spans(options: ConvertOptions, frames: FrameSet) -> BoxSpans:
    """How boxes are left out of labels of this layout."""
    from filter_core.formats.registry import FORMATS, layout_format

    if options.option:
        raise typer.BadParameter(
            f"--option {options.option[0].partition('=')[0]} is for labels that are "
            "written anew; --to same takes boxes away, and changes nothing else"
        )
    spans = layout_format(frames.layout).box_spans
    if spans is None:
        able = ", ".join(name for name, layout in FORMATS.items() if layout.box_spans)
        raise Refused(
            f"layout {frames.layout} cannot be written as it came; those that can are "
            f"{able}; --to FORMAT writes another format"
        )
    return spans


def _require_apart(options: ConvertOptions, folder: Path) -> None:
    """Refuse an output folder that is or lies in the source, or the reverse."""
    source, output = folder.resolve(), options.output.resolve()
    is_folder = options.source.is_dir()
    if (is_folder and output.is_relative_to(source)) or source.is_relative_to(output):
        raise Refused(
            f"--output {options.output}: expected a folder outside of the recording, "
            f"which is copied, found one in or around {options.source}"
        )


def _note_copy(
    options: ConvertOptions, frames: FrameSet, progress: _Progress, left: LeftBehind
) -> None:
    """Note how the folder was read, and what of it is not in the copy."""
    screen = options.screen
    progress.notes.print(screen)
    progress.note_unread(frames)
    if progress.failed:
        screen.note(
            f"the labels of {progress.failed} refused frames were copied as they are"
        )
    if left.outside:
        screen.note(
            one_line(
                f"{len(left.outside)} files of frames lie outside of {options.source} "
                f"and were not copied, the first is {left.outside[0]}"
            )
        )
    if left.special:
        screen.note(
            one_line(
                f"{len(left.special)} pipes or devices were not copied, the first is "
                f"{left.special[0]}"
            )
        )


class _Progress:
    """Passes on the frames that can be written, counts them, and lists the others."""

    def __init__(self, screen: Screen, summary: BoxSummary) -> None:
        self.screen = screen
        self.summary = summary
        self.notes = ImageNotes()
        self.written = 0
        self.failed = 0
        self.refusals = Kinds()
        self.check = sources.FrameCheck()

    def add_outcome(self, outcome: FrameOutcome) -> None:
        """Count a frame; one that has an error is listed."""
        if outcome.error is None:
            self.written += 1
            self.add(outcome.classes, outcome.notes)
            return
        first = outcome.error["errors"][0]
        self._refuse(outcome.key, outcome.error["detail"], first["code"])

    def note_unread(self, frames: FrameSet) -> None:
        """Note how the folder was read, and which of its files were not."""
        self.check.note(self.screen, frames)
        for line in (*self.refusals.more(), *sources.unmatched_lines(frames.unmatched)):
            self.screen.note(line)

    def require_frames(self) -> None:
        """Refuse to go on if no frame could be read."""
        if not self.written:
            for line in self.refusals.more():
                self.screen.note(line)
            raise Refused(f"no frame can be read ({self.failed} refused)")

    def _refuse(self, key: str, why: str, code: str) -> None:
        self.failed += 1
        if self.refusals.is_listed(f"refused ({code})"):
            self.screen.note(refusal(key, sources.naming_reading(why)))

    def add(self, classes: Mapping[str, ClassCount], notes: Iterable[str]) -> None:
        """The boxes of one frame by class, and how its images were read."""
        self.summary.add(classes)
        self.notes.add(notes)

    def watch(
        self, frames: Iterable[ExportFrame | LeftOut], total: int | None
    ) -> Iterator[ExportFrame]:
        """The frames to be written, under a bar."""
        from filter_core.errors import problem_of
        from filter_core.formats.export import ExportFrame

        with self.screen.progress("convert", "frames") as advance:
            for frame in frames:
                if isinstance(frame, ExportFrame):
                    self.written += 1
                    yield frame
                else:
                    fault = problem_of(frame.problem)
                    code = fault["errors"][0]["code"]
                    self._refuse(frame.key, frame.problem.detail, code)
                advance(self.written + self.failed, total)
