"""`unghost doctor` and `unghost gc`: looking a data folder over, and clearing it up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from unghost.cli.command import command
from unghost.cli.data_options import DataOptions, refusals
from unghost.cli.exits import PARTLY, REFUSED


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(DataOptions):
    """Options of `unghost doctor`."""

    verify: Annotated[
        bool,
        typer.Option("--verify", help="Read every stored file and compare its hash."),
    ] = False


@dataclass(frozen=True, kw_only=True)
class GarbageOptions(DataOptions):
    """Options of `unghost gc`."""

    grace: Annotated[
        float,
        typer.Option(
            "--grace", metavar="HOURS", min=0, help="Keep files that are younger."
        ),
    ] = 24
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only say what would be removed.")
    ] = False


def register(app: typer.Typer) -> None:
    """Add the commands."""
    command(app, "doctor")(doctor)
    command(app, "gc")(gc)


def doctor(options: DoctorOptions) -> None:
    """Look a data folder over, also while it is served, and say what to do.

    Exits with 1 if anything is damaged or missing, with 3 if something should be done.
    """
    from app.services.doctor import examine
    from app.services.findings import Severity

    screen = options.screen
    worst = set()
    for finding in examine(
        options.settings, verify=options.verify, steps=screen.progress
    ):
        worst.add(finding.severity)
        screen.record(finding.as_dict())
        screen.text(f"{finding.severity.value:8}{finding.check}: {finding.found}")
        for example in finding.examples:
            screen.text(f"        {example}")
        if finding.todo:
            screen.text(f"        -> {finding.todo}")
    if Severity.ERROR in worst:
        raise typer.Exit(REFUSED)
    if Severity.WARNING in worst:
        raise typer.Exit(PARTLY)


def gc(options: GarbageOptions) -> None:
    """Remove stored files that nothing refers to any more, also while it is served.

    Deleted frames and datasets leave their files behind until this is run.
    """
    from app.services.garbage import collect

    screen = options.screen
    with refusals():
        found = collect(
            options.settings,
            grace_hours=options.grace,
            dry_run=options.dry_run,
            steps=screen.progress,
        )
    done = "removed" if found.removed else "would remove"
    screen.record(
        found.as_dict(),
        f"{done} {found.files} files of {found.size_bytes} bytes and "
        f"{found.leftovers} half written ones; {found.too_young} unused are too young",
    )
