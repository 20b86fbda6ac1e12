"""`unghost backup` and `unghost restore`: a data folder, kept somewhere else."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from unghost.cli.command import command
from unghost.cli.data_options import DataOptions, refusals
from unghost.cli.exits import PARTLY


@dataclass(frozen=True, kw_only=True)
class BackupOptions(DataOptions):
    """Options of `unghost backup`."""

    target: Annotated[
        Path,
        typer.Argument(
            metavar="TARGET", help="A new folder, or a new file that ends in .tar."
        ),
    ]
    incomplete: Annotated[
        bool,
        typer.Option("--incomplete", help="Leave out files that are damaged."),
    ] = False


@dataclass(frozen=True, kw_only=True)
class RestoreOptions(DataOptions):
    """Options of `unghost restore`."""

    backup: Annotated[
        Path, typer.Argument(metavar="BACKUP", help="The folder or file of a backup.")
    ]


def register(app: typer.Typer) -> None:
    """Add the commands."""
    command(app, "backup")(backup)
    command(app, "restore")(restore)


def backup(options: BackupOptions) -> None:
    """Copy a data folder, also while it is served; the copy is read again at the end.

    It holds every answer that was given before, and gets its name when it is whole.
    """
    from app.services.backups import make_backup

    screen = options.screen
    with refusals():
        made = make_backup(
            options.settings,
            options.target,
            incomplete=options.incomplete,
            steps=screen.progress,
        )
    text = f"{made.path}: {made.files} files, {made.size_bytes} bytes, read again"
    screen.record(made.as_dict(), text)
    if made.left_out:
        screen.note(f"{len(made.left_out)} damaged files were left out")
        raise typer.Exit(PARTLY)


def restore(options: RestoreOptions) -> None:
    """Make a data folder of a backup; the folder must be empty, or not be there.

    Every file is compared with its hash while it is copied.
    """
    from app.services.restoring import restore as restored

    screen = options.screen
    with refusals():
        done = restored(options.settings, options.backup, screen.progress)
    text = f"{done.data}: {done.files} files, as of {done.created_at}"
    screen.record(done.as_dict(), text)
    if done.is_older:
        screen.note("`unghost serve` brings its schema up to date when it starts")
    if done.left_out:
        screen.note(f"{len(done.left_out)} files are not in the backup")
        raise typer.Exit(PARTLY)
