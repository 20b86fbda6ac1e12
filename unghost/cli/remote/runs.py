"""Commands for runs and for configurations.

`unghost run`, `wait`, `cancel` and `diff` are about runs, `unghost config` is about the
configuration of a dataset.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer

from unghost.cli.options import (
    ConfigFile,
    DatasetOptions,
    ServerOptions,
    config_text,
    error_context,
    note_unknown_classes,
)
from unghost.cli.screen import Screen, most_first
from unghost.cli.sources import SEGMENTATION_SETTINGS, note_unused_keys

if TYPE_CHECKING:
    from unghost.client.client import Client
    from unghost.wire import ConfigVersion, Diff, FlipCounts, Run


_DIFF_COLUMNS: Final = ("class", "boxes", "kept -> rejected", "rejected -> kept")
_OF_PAGES: Final = ("items", "next_cursor")
"""What `unghost diff --json` has in lines of its own; the last one has the sums."""

_CAUSES: Final = {
    "class_known": "the name of its class is understood now",
    "edge_rounded": "an edge that was rounded is a whole number again",
}
"""Of each `FlipCause`, what it means."""

CancelOnInterrupt: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--cancel-on-interrupt",
        help="Ctrl-C also cancels the run on the server; otherwise the run continues.",
    ),
]

RunNumber: TypeAlias = Annotated[
    int, typer.Argument(metavar="RUN", help="Number of the run.")
]


@dataclass(frozen=True, kw_only=True)
class RunOptions(DatasetOptions):
    config: ConfigFile
    activate: Annotated[
        bool,
        typer.Option("--activate", help="Make the run the active one when it is done."),
    ] = False
    wait: Annotated[
        bool,
        typer.Option(
            "--wait", help="Wait until the run is done and show its progress."
        ),
    ] = False
    measure_again: Annotated[
        bool,
        typer.Option(
            "--measure-again",
            help="Read the images again if an earlier version of Unghost has measured "
            "the numbers, also where those would do.",
        ),
    ] = False
    cancel_on_interrupt: CancelOnInterrupt = False


@dataclass(frozen=True, kw_only=True)
class WaitOptions(ServerOptions):
    run: RunNumber
    cancel_on_interrupt: CancelOnInterrupt = False


@dataclass(frozen=True, kw_only=True)
class CancelOptions(ServerOptions):
    run: RunNumber


def run(options: RunOptions) -> None:
    """Apply a configuration to a whole dataset.

    The current verdicts do not change, except with --activate.
    """
    if options.cancel_on_interrupt and not options.wait:
        raise typer.BadParameter("--cancel-on-interrupt is for --wait")
    with options.connect() as client:
        version = _add_config(client, options, options.config)
        started = client.start_run(
            options.dataset,
            version.digest,
            activate=options.activate,
            measure_again=options.measure_again,
        )
        if options.wait:
            started = wait_for_run(
                client, started, options.screen, cancel=options.cancel_on_interrupt
            )
    options.screen.record(started.raw, run_line(started))


def wait(options: WaitOptions) -> None:
    """Wait until a run is done and show its progress.

    Exit code 1 if the run fails or is cancelled.
    """
    with options.connect() as client:
        run = client.run(options.run)
        done = wait_for_run(
            client, run, options.screen, cancel=options.cancel_on_interrupt
        )
    options.screen.record(done.raw, run_line(done))


def cancel(options: CancelOptions) -> None:
    """Cancel a run that has not ended; nothing in its dataset changes."""
    with options.connect() as client:
        cancelled = client.cancel(options.run)
    options.screen.record(cancelled.raw, run_line(cancelled))


def wait_for_run(
    client: Client, run: Run, screen: Screen, *, cancel: bool = False
) -> Run:
    """Wait until a run is done, with a progress bar.

    If interrupted, the run continues and a message says so; with `cancel` it is
    cancelled.

    Raises `RunFailed`: it did not succeed.
    """
    from unghost.client.errors import Unavailable

    try:
        with screen.progress(f"run {run.id}", "frames") as advance:
            return client.wait(
                run, progress=lambda state: advance(state.done, state.total)
            )
    except KeyboardInterrupt:
        message = (
            f"interrupted; run {run.id} continues on the server: `unghost wait "
            f"{run.id}` waits for it, `unghost cancel {run.id}` cancels it"
        )
        if cancel:
            outcome = cancel_interrupted(f"run {run.id}", lambda: client.cancel(run))
            message = f"interrupted; {outcome}"
        raise KeyboardInterrupt(message) from None
    except Unavailable:
        screen.note(
            f"run {run.id} continues when the server does: `unghost wait {run.id}` "
            "waits for it"
        )
        raise


def cancel_interrupted(job: str, cancel: Callable[[], object]) -> str:
    """Cancel a run or an export whose command is interrupted; says what became of it.

    `job` is its name in the sentence: "run 3"; `cancel` sends the request. The server
    may be away.
    """
    from unghost.client.errors import ApiError, Conflict

    try:
        cancel()
    except Conflict:  # it was faster
        return f"{job} had ended already"
    except ApiError:
        return f"{job} could not be cancelled and continues on the server"
    return f"{job} was cancelled"


def run_line(run: Run) -> str:
    """A run in one line for people."""
    parts = [f"run {run.id}", run.state]
    if run.state == "done":
        parts.append(f"{run.changed} boxes with another verdict or reason")
        parts.append(f"{run.counts.kept} kept, {run.counts.rejected} rejected")
    return "\t".join(parts)


@dataclass(frozen=True, kw_only=True)
class DiffOptions(ServerOptions):
    before: Annotated[int, typer.Argument(metavar="RUN", help="Number of a run.")]
    after: Annotated[
        int, typer.Argument(metavar="RUN", help="Number of the run to compare it with.")
    ]


def diff(options: DiffOptions) -> None:
    """Compare two runs: how many boxes of each class they decide differently.

    With --json there is a line for each of these boxes; the last line has the sums.
    """
    screen = options.screen
    with options.connect() as client:
        comparison = client.diff(options.after, options.before)
        if options.json:
            for flip in client.flips(options.after, options.before):
                screen.record(flip.raw)
    sums = type(comparison).model_fields.keys() - _OF_PAGES
    screen.record({k: v for k, v in comparison.raw.items() if k in sums})
    screen.table(_DIFF_COLUMNS, rows_of(comparison))
    for cause, boxes in comparison.by_cause.items():
        screen.note(f"{boxes} of them: {_CAUSES.get(cause, cause)}")
    screen.note(
        f"{comparison.total} of {comparison.compared} boxes have another verdict in "
        f"run {comparison.run} than in run {comparison.against}"
    )


def rows_of(comparison: Diff) -> list[tuple[object, ...]]:
    """A row per class, those with most changes first, and one of all."""
    # An older server does not send the directions; that does not mean 0.
    unknown = (0, 0) if "sides_by_class" in comparison.raw else (None, None)
    ways = {name: _ways(counts) for name, counts in comparison.sides_by_class.items()}
    rows = [
        (name, count, *ways.get(name, unknown))
        for name, count in most_first(comparison.by_class)
    ]
    return [*rows, ("all", comparison.total, *_ways(comparison))]


def _ways(counts: FlipCounts) -> tuple[int, int]:
    return counts.kept_to_rejected, counts.rejected_to_kept


def show_config(options: DatasetOptions) -> None:
    """Print the active configuration as YAML, every key with its value.

    A comment lists the dataset's own settings, which are used in place of these keys.
    """
    import yaml

    from unghost.wire.datasets import DatasetIn

    with options.connect() as client:
        version = client.active_config(options.dataset)
        dataset = client.dataset(options.dataset)
    defaults = {name: field.default for name, field in DatasetIn.model_fields.items()}
    own = {name: getattr(dataset, name) for name in SEGMENTATION_SETTINGS}
    # A dataset's setting that is not the default is used in place of the key.
    used = (
        f"the dataset's own setting is used: {name}: {value}"
        for name, value in own.items()
        if value not in (defaults[name], version.config[name])
    )
    head = [f"digest: {version.digest}", *used]
    text = yaml.safe_dump(dict(version.config), sort_keys=False, allow_unicode=True)
    comments = "".join(f"# {line}\n" for line in head)
    options.screen.record(version.raw, f"{comments}{text.rstrip()}")


@dataclass(frozen=True, kw_only=True)
class ConfigSetOptions(DatasetOptions):
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
        typer.Option("--wait/--no-wait", help="Wait until every frame is decided."),
    ] = True
    merge: Annotated[
        bool,
        typer.Option(
            "--merge",
            help="Change only what FILE names, and of its classes only their keys that "
            "it names; without it, everything else gets its default.",
        ),
    ] = False


def set_config(options: ConfigSetOptions) -> None:
    """Store a configuration and make it the active one.

    What FILE does not name gets its default, and is listed before; --merge keeps it.
    Every frame is decided again; until then the old verdicts stay current. Refused if
    somebody else makes another configuration active at the same time.
    """
    from filter_core.config.file import load_config
    from filter_core.config.filter import FilterConfig, diff_configs

    screen = options.screen
    with error_context(options.config):
        loaded = load_config(options.config.read_bytes())
    with options.connect() as client:
        active = client.active_config(options.dataset)
        before = FilterConfig.from_mapping(active.config)
        if options.merge:
            with error_context(options.config):
                # Class by class and key by key
                entries = {
                    name: limits.as_dict() for name, limits in before.classes.items()
                }
                for name, limits in loaded.config.classes.items():
                    entries[name] = {**entries.get(name, {}), **limits.as_dict()}
                keys = {**before.as_dict(), **loaded.keys, "classes": entries}
                merged = FilterConfig.from_mapping(keys)
                version = client.add_config(options.dataset, merged.as_dict())
            _note_unknown_classes(client, options, version.config)
        else:
            version = _add_config(client, options, options.config)
            for change in diff_configs(before, loaded.after(before)):
                if not _is_named(change.key, loaded.keys):
                    screen.note(
                        f"{change.key} is not in {options.config.name} and gets its "
                        f"default: {json.dumps(change.before)} -> "
                        f"{json.dumps(change.after)} (--merge keeps it)"
                    )
        note_unused_keys(loaded.unused_keys, screen)
        run = client.set_config(
            options.dataset, version.digest, instead_of=active.digest
        )
        if options.wait:
            run = wait_for_run(client, run, screen)
    screen.record(run.raw, f"config {version.digest[:12]}\t{run_line(run)}")


def _is_named(key: str, keys: Mapping[str, object]) -> bool:
    """Whether a file with these keys says something about a key of `diff_configs`."""
    classes = keys.get("classes")
    if key.startswith("classes.") and isinstance(classes, Mapping):
        return any(
            key.startswith(f"classes.{name}.")
            and (not isinstance(own, Mapping) or key.rpartition(".")[2] in own)
            for name, own in classes.items()
        )
    return key in keys


def _add_config(
    client: Client, options: RunOptions | ConfigSetOptions, file: Path
) -> ConfigVersion:
    text = config_text(file)
    with error_context(file):
        version = client.add_config(options.dataset, text)
    _note_unknown_classes(client, options, version.config)
    return version


def _note_unknown_classes(
    client: Client,
    options: RunOptions | ConfigSetOptions | ConfigDiffOptions,
    config: Mapping[str, object],
) -> None:
    if config.get("classes"):
        counts = client.stats(options.dataset).by_class
        boxes = {
            name: each.kept + each.rejected + each.unmeasured
            for name, each in counts.items()
        }
        note_unknown_classes(options.screen, config, boxes)


@dataclass(frozen=True, kw_only=True)
class ConfigDiffOptions(DatasetOptions):
    config: ConfigFile


def diff_config(options: ConfigDiffOptions) -> None:
    """Compare a file with the active configuration, and count changed verdicts.

    Nothing is changed on the server.
    """
    from filter_core.config.file import load_config
    from filter_core.config.filter import FilterConfig, diff_configs

    with error_context(options.config):
        loaded = load_config(options.config.read_bytes())
    with options.connect() as client:
        old = client.active_config(options.dataset)
        new = loaded.after(FilterConfig.from_mapping(old.config))
        _note_unknown_classes(client, options, new.as_dict())
        preview = client.preview(options.dataset, new.as_dict())
    changes = diff_configs(FilterConfig.from_mapping(old.config), new)
    screen, flips = options.screen, preview.flips
    names = ("total", "kept_to_rejected", "rejected_to_kept")
    counts = flips and {name: getattr(flips, name) for name in names}
    screen.record(
        {
            "changes": [change._asdict() for change in changes],
            "needs_pixels": preview.needs_pixels,
            "flips": counts,
        }
    )
    screen.table(
        ("key", "active", options.config.name),
        [
            (each.key, json.dumps(each.before), json.dumps(each.after))
            for each in changes
        ],
    )
    if flips is None:
        screen.note(
            "images must be measured again: which verdicts change is known after a run"
        )
    else:
        screen.note(
            f"{flips.total} boxes would flip: {flips.kept_to_rejected} kept to "
            f"rejected, {flips.rejected_to_kept} rejected to kept"
        )
