"""`unghost config show | set | diff`: what a dataset is decided by."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from unghost.cli.command import command
from unghost.cli.config_files import config_text, naming
from unghost.cli.options import ConfigFile, DatasetName, ServerOptions
from unghost.cli.waiting import run_line, wait_for_run

if TYPE_CHECKING:
    from filter_core.config.filter import ConfigChange
    from unghost.work_results import Preview

app = typer.Typer(
    help="Show, set or compare a dataset's configuration.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@dataclass(frozen=True, kw_only=True)
class ShowOptions(ServerOptions):
    """Options of `unghost config show`."""

    dataset: DatasetName


@command(app, "show")
def show(options: ShowOptions) -> None:
    """Print the active configuration as YAML, every key with its value."""
    import yaml

    with options.connect() as client:
        version = client.active_config(options.dataset)
    text = yaml.safe_dump(dict(version.config), sort_keys=False, allow_unicode=True)
    options.screen.record(version.raw, f"# digest: {version.digest}\n{text.rstrip()}")


@dataclass(frozen=True, kw_only=True)
class SetOptions(ServerOptions):
    """Options of `unghost config set`."""

    dataset: DatasetName
    config: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A filter configuration (YAML), or carlasimu's boundingBox.yaml.",
            exists=True,
            dir_okay=False,
        ),
    ]
    wait: Annotated[
        bool,
        typer.Option("--wait/--no-wait", help="Return when every frame is decided."),
    ] = True


@command(app, "set")
def set_config(options: SetOptions) -> None:
    """Store a configuration and make it the active one.

    Every frame is decided again; until that is done the old verdicts count.
    """
    screen = options.screen
    with options.connect() as client:
        text = config_text(options.config)
        with naming(options.config):
            version = client.add_config(options.dataset, text)
        if version.unused_keys:
            screen.note(f"not used here: {', '.join(version.unused_keys)}")
        run = client.set_config(options.dataset, version.digest)
        if options.wait:
            run = wait_for_run(client, run, screen)
    screen.record(run.raw, f"config {version.digest[:12]}\t{run_line(run)}")


@dataclass(frozen=True, kw_only=True)
class DiffOptions(ServerOptions):
    """Options of `unghost config diff`."""

    dataset: DatasetName
    config: ConfigFile


@command(app, "diff")
def diff(options: DiffOptions) -> None:
    """Compare a file with the active configuration, and count what would flip.

    Nothing is changed.
    """
    from filter_core.config.file import load_config
    from filter_core.config.filter import FilterConfig, diff_configs

    with naming(options.config):
        new = load_config(options.config.read_bytes()).config
    with options.connect() as client:
        old = client.active_config(options.dataset)
        preview = client.preview(options.dataset, new.as_dict())
    changes = diff_configs(FilterConfig.from_mapping(old.config), new)
    _print_diff(options, changes, preview)


def _print_diff(
    options: DiffOptions, changes: list[ConfigChange], preview: Preview
) -> None:
    screen, flips = options.screen, preview.flips
    counts = {
        "total": flips.total,
        "kept_to_rejected": flips.kept_to_rejected,
        "rejected_to_kept": flips.rejected_to_kept,
    }
    screen.record(
        {
            "changes": [vars(change) for change in changes],
            "needs_pixels": preview.needs_pixels,
            "flips": None if preview.needs_pixels else counts,
        }
    )
    screen.table(
        ("key", "active", options.config.name),
        [
            (each.key, json.dumps(each.before), json.dumps(each.after))
            for each in changes
        ],
    )
    if preview.needs_pixels:
        screen.note("this needs pixels: what would flip is known after a run")
    else:
        screen.note(
            f"{flips.total} boxes would flip: {flips.kept_to_rejected} kept to "
            f"rejected, {flips.rejected_to_kept} rejected to kept"
        )
