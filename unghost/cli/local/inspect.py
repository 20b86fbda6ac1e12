"""`unghost inspect`: how a folder is understood, before anything runs or is stored."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from unghost.cli import sources
from unghost.cli.options import OutputOptions, written_file
from unghost.cli.screen import PARTLY, Refused, Screen, one_line

if TYPE_CHECKING:
    from filter_core.inspection.listing import Listed
    from filter_core.inspection.recording import ClassFacts, Inspection


@dataclass(frozen=True, kw_only=True)
class InspectOptions(OutputOptions, sources.SourceOptions):
    source: sources.SourceFolder
    html: Annotated[
        Path | None,
        written_file(
            metavar="FILE.html",
            help="Write a page that shows it all, with three frames and the verdicts "
            "of their boxes.",
        ),
    ] = None
    write: Annotated[
        Path | None,
        written_file(
            metavar="FILE.yaml",
            help="Write what was recognised as a description of the recording, which "
            "is found by itself as recording.yaml in the folder; a file that exists "
            "is not replaced.",
        ),
    ] = None


@sources.reads_archives
def inspect(options: InspectOptions) -> None:
    """Show how a folder is understood, before anything is filtered or stored.

    Reads all labels and a few of the pictures: layout, images by role, classes and
    what they measure as, tags, depth, splits, cameras, and every file that is not used.
    Exit code 3 if `filter` would end with another code than 0, with what helps.
    """
    from filter_core.inspection.recording import inspect_recording
    from filter_core.inspection.remarks import recording_text, remarks_on

    if options.write is not None and options.write.exists():
        raise Refused(f"{options.write} exists already, and was not replaced")
    description = options.description_of(options.source)
    if options.layout != "auto":
        description = replace(description, layout=options.layout)
    with options.screen.progress("inspect", "frames") as advance:
        inspection = inspect_recording(options.source, description, progress=advance)
    remarks = [
        remark._replace(text=sources.with_options(remark.text))
        for remark in remarks_on(inspection)
    ]
    is_folder = options.source.is_dir()
    folder = options.source if is_folder else options.source.parent
    text = recording_text(inspection, folder)
    record = {
        field.name: plain(getattr(inspection, field.name))
        for field in fields(inspection)
        if field.name != "described"  # which is the text
    }
    said = [remark._asdict() for remark in remarks]
    options.screen.record({**record, "remarks": said, "description": text})
    _print(inspection, options.screen)
    for remark in remarks:
        mark = "! " if remark.is_serious else ""
        options.screen.note(one_line(f"{mark}{remark.text}"))
    if options.html is not None:
        from filter_core.formats.files import write_whole
        from unghost.cli.inspect_page import page

        write_whole(options.html, page(inspection, remarks, text).encode())
        options.screen.note(f"written: {options.html}")
    if options.write is not None:
        with options.write.open("x", encoding="utf-8") as file:
            file.write(text)
        options.screen.note(f"written: {options.write}")
    if any(remark.is_serious for remark in remarks):
        raise typer.Exit(PARTLY)


def plain(value: object) -> object:
    """A value of an inspection as JSON has it, without pictures."""
    if is_dataclass(value):
        return {
            field.name: plain(getattr(value, field.name))
            for field in fields(value)
            if field.name != "jpeg"
        }
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {key: plain(each) for key, each in value._asdict().items()}
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return value


def _print(inspection: Inspection, screen: Screen) -> None:
    from filter_core.inspection.remarks import FAULTS, ROLES, by_role, facts, told_by

    table = partial(screen.table, headed=True)
    table(("recording", "is"), facts(inspection), tag="recording")
    table(
        ("role", "images", "told by", "such as"),
        [
            (
                ROLES.get(stream.role, stream.role),
                stream.images,
                told_by(stream),
                stream.example,
            )
            for stream in by_role(inspection)
        ],
        tag="images",
    )
    of_class = ("class", "boxes", "measured as", "looked at")
    table(
        (*of_class, *_WORDS, "% unknown", "unknown tags"),
        map(_class_row, inspection.classes),
        tag="class",
    )
    table(
        ("boxes", "number", "such as"),
        [
            (FAULTS[fault.kind], fault.count, f"{example.name}: {example.why}")
            for fault in inspection.boxes.faults
            for example in fault.examples[:1]
        ],
        tag="boxes",
    )
    table(
        ("frame", "kept", "rejected", "unmeasured"),
        [
            (
                frame.key,
                *(sum(box.verdict == word for box in frame.boxes) for word in _WORDS),
            )
            for frame in inspection.drawn
        ],
        tag="frame",
    )
    refused = [*inspection.refused, *inspection.refused_pictures]
    table(("frame that cannot be used", "why"), _rows(refused), tag="refused")
    unused = [*inspection.left_over, *inspection.not_read]
    table(("file that is not used", "why"), _rows(unused), tag="file")


_WORDS: Final = ("kept", "rejected", "unmeasured")


def _rows(kinds: Sequence[Listed]) -> Iterator[tuple[str, str]]:
    """Names with what is said about them: ten of a kind, then a number."""
    for listed in kinds:
        yield from listed.examples
        if more := listed.count - len(listed.examples):
            yield f"and {more:,} more like this", listed.kind


def _class_row(class_facts: ClassFacts) -> tuple[object, ...]:
    from filter_core.inspection.remarks import measured_as

    share = class_facts.unknown_percent
    return (
        class_facts.name,
        class_facts.boxes,
        measured_as(class_facts.measured_as, class_facts.nearest),
        class_facts.looked_at.boxes,
        class_facts.kept,
        class_facts.looked_at.rejected,
        class_facts.unmeasured,
        None if share is None else round(share, 1),
        ", ".join(
            f"{value} ({pixels:,} px)" for value, pixels in class_facts.unknown[:3]
        ),
    )
