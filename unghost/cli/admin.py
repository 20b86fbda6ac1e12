"""Maintenance of a data folder, even while it is served: backup, doctor, gc."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from unghost.cli.options import DataOptions
from unghost.cli.screen import PARTLY, REFUSED, refused_on


@dataclass(frozen=True, kw_only=True)
class BackupOptions(DataOptions):
    target: Annotated[
        Path,
        typer.Argument(
            metavar="TARGET",
            help="The folder to create, or the file to create, if it ends in .tar.",
        ),
    ]
    incomplete: Annotated[
        bool,
        typer.Option(
            "--incomplete",
            help="Leave out damaged files, instead of refusing to back up.",
        ),
    ] = False


@dataclass(frozen=True, kw_only=True)
class RestoreOptions(DataOptions):
    backup: Annotated[
        Path,
        typer.Argument(
            metavar="BACKUP", help="The folder or the .tar file that `backup` wrote."
        ),
    ]


def backup(options: BackupOptions) -> None:
    """Copy a data folder, also while it is served, and check the copy.

    The copy has everything that the server acknowledged before. It gets its name when
    it is complete.
    """
    from app.maintenance.backup import make_backup
    from app.maintenance.datafolder import CannotMaintain

    screen = options.screen
    with refused_on(CannotMaintain):
        made = make_backup(
            options.settings,
            options.target,
            incomplete=options.incomplete,
            steps=screen.progress,
        )
    text = f"{made.path}: {made.files} files, {made.size_bytes} bytes, verified"
    if made.audit is not None:
        text += (
            f"\naudit log: {made.audit.partition(':')[0]} entries; later, compare with "
            f"`unghost doctor --audit {made.audit}`"
        )
    screen.record(made.as_dict(), text)
    if made.left_out:
        screen.note(f"{len(made.left_out)} damaged files were left out")
        raise typer.Exit(PARTLY)


def restore(options: RestoreOptions) -> None:
    """Create a data folder from a backup; the folder must be empty or not exist.

    Every file is compared with its hash while it is copied.
    """
    from app.maintenance.datafolder import CannotMaintain
    from app.maintenance.restore import is_older
    from app.maintenance.restore import restore as restored

    screen, data = options.screen, options.settings.data.absolute()
    with refused_on(CannotMaintain):
        label, files = restored(options.settings, options.backup, screen.progress)
    record = {
        "data": str(data),
        "files": files,
        "schema": label.schema,
        "created_at": label.created_at,
        "left_out": label.left_out,
    }
    screen.record(record, f"{data}: {files} files, as of {label.created_at}")
    if is_older(label):
        screen.note("`unghost serve` brings its schema up to date when it starts")
    if label.left_out:
        screen.note(f"{len(label.left_out)} files are not in the backup")
        raise typer.Exit(PARTLY)


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(DataOptions):
    verify: Annotated[
        bool,
        typer.Option("--verify", help="Read every stored file and compare its hash."),
    ] = False
    audit: Annotated[
        str | None,
        typer.Option(
            metavar="COUNT:SHA256",
            help="Compare the audit log with what a backup, or an earlier check, has "
            "printed.",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class GarbageOptions(DataOptions):
    grace: Annotated[
        float,
        typer.Option(
            metavar="HOURS", min=0, help="Keep files that are younger than this."
        ),
    ] = 24
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only print what would be removed.")
    ] = False


def doctor(options: DoctorOptions) -> None:
    """Check a data folder, even while it is served, and say what to do.

    Exits with 1 if anything is damaged or missing, with 3 if something should be done.
    """
    from app.maintenance.doctor import Severity, examine
    from app.maintenance.queries import AuditMark

    try:
        audit = None if options.audit is None else AuditMark.read(options.audit)
    except ValueError as exc:
        raise typer.BadParameter(f"--audit: {exc}") from exc
    screen = options.screen
    severities = set()
    for finding in examine(
        options.settings, verify=options.verify, steps=screen.progress, audit=audit
    ):
        severities.add(finding.severity)
        screen.record(finding.as_dict())
        screen.text(f"{finding.severity.value:8}{finding.check}: {finding.found}")
        for example in finding.examples:
            screen.text(f"        {example}")
        if finding.todo:
            screen.text(f"        -> {finding.todo}")
    if Severity.ERROR in severities:
        raise typer.Exit(REFUSED)
    if Severity.WARNING in severities:
        raise typer.Exit(PARTLY)


def gc(options: GarbageOptions) -> None:
    """Remove stored files that nothing refers to any more, also while it is served.

    Deleted frames and datasets leave their files behind until this is run.
    """
    from app.maintenance.datafolder import CannotMaintain
    from app.maintenance.gc import collect

    screen = options.screen
    with refused_on(CannotMaintain):
        garbage = collect(
            options.settings,
            grace_hours=options.grace,
            dry_run=options.dry_run,
            steps=screen.progress,
        )
    done = "removed" if garbage.removed else "would remove"
    screen.record(
        garbage.as_dict(),
        f"{done} {garbage.files} files of {garbage.size_bytes} bytes and "
        f"{garbage.leftovers} incomplete ones; {garbage.too_young} unused ones are "
        "kept, since they are younger than --grace",
    )
