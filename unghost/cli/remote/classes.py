"""`unghost classes`: shows, renames, merges and removes the classes of a dataset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer

from unghost.cli.options import DatasetOptions
from unghost.cli.remote.runs import run_line, wait_for_run

if TYPE_CHECKING:
    from unghost.client.client import Client
    from unghost.wire import Run

_COLUMNS: Final = ("class", "boxes", "kept", "rejected", "unmeasured", "former names")

ClassName: TypeAlias = Annotated[
    str, typer.Argument(metavar="CLASS", help="Name of the class.")
]


@dataclass(frozen=True, kw_only=True)
class RemoveClassOptions(DatasetOptions):
    name: ClassName


@dataclass(frozen=True, kw_only=True)
class _ChangeClassOptions(DatasetOptions):
    wait: Annotated[
        bool,
        typer.Option(
            "--wait/--no-wait", help="Wait until the boxes are measured and decided."
        ),
    ] = True


@dataclass(frozen=True, kw_only=True)
class RenameClassOptions(_ChangeClassOptions):
    name: ClassName
    new: Annotated[str, typer.Argument(metavar="NEW", help="Its new name.")]


@dataclass(frozen=True, kw_only=True)
class MergeClassOptions(_ChangeClassOptions):
    name: ClassName
    into: Annotated[
        str, typer.Argument(metavar="INTO", help="The class that gets its boxes.")
    ]


def show_classes(options: DatasetOptions) -> None:
    """List a dataset's classes in the order of exports, with their boxes.

    Boxes that come in with a former name of a class get the class, too.
    """
    with options.connect() as client:
        dataset = client.dataset(options.dataset)
        by_class = client.stats(options.dataset).by_class
    rows = []
    for name in dataset.classes:
        counts = by_class.get(name)
        numbers = (
            (counts.kept, counts.rejected, counts.unmeasured) if counts else (0,) * 3
        )
        former = [old for old, now in dataset.renamed_classes.items() if now == name]
        rows.append((name, sum(numbers), *numbers, ", ".join(former)))
        record = dict(zip(_COLUMNS[:5], rows[-1], strict=False))
        options.screen.record({**record, "former_names": former})
    options.screen.table(_COLUMNS, rows)
    if dataset.classes_frozen:
        options.screen.note(
            f"the classes of {dataset.name} are frozen: exported labels refer to their "
            "numbers"
        )


def rename_class(options: RenameClassOptions) -> None:
    """Rename a class; its boxes are measured as what the new name means.

    Refused once labels were exported in a format with class numbers (YOLO, COCO).
    """
    with options.connect() as client:
        run = client.rename_class(options.dataset, options.name, options.new)
        _finish(client, options, run)


def merge_class(options: MergeClassOptions) -> None:
    """Give a class's boxes another class, such as those of a misspelt one.

    Frames that are pushed later with the former name get the other class, too. Refused
    once labels were exported in a format with class numbers (YOLO, COCO).
    """
    with options.connect() as client:
        run = client.merge_class(options.dataset, options.name, options.into)
        _finish(client, options, run)


def _finish(client: Client, options: _ChangeClassOptions, run: Run) -> None:
    if options.wait:
        run = wait_for_run(client, run, options.screen)
    options.screen.record(run.raw, run_line(run))


def remove_class(options: RemoveClassOptions) -> None:
    """Remove a class that has no boxes.

    Refused once labels were exported in a format with class numbers (YOLO, COCO).
    """
    with options.connect() as client:
        client.remove_class(options.dataset, options.name)
    record = {"dataset": options.dataset, "removed": options.name}
    options.screen.record(record, f"{options.name}\tremoved")
