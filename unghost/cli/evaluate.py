"""`unghost evaluate`: which channel is right how often, on your own frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from unghost.cli.command import command
from unghost.cli.exits import PARTLY, REFUSED
from unghost.cli.options import OutputOptions
from unghost.cli.score_plot import f1_plot
from unghost.cli.screen import Screen
from unghost.cli.source_options import LocalFilterOptions
from unghost.cli.sources import open_source, read_config
from unghost.cli.suggested_thresholds import ThresholdsAsked

if TYPE_CHECKING:
    from filter_core.local import EvaluationTask

_COLUMNS = ("precision", "recall", "F1", "low", "high", "ghosts kept", "visible lost")


class Channel(str, Enum):
    """What can be compared."""

    SEMANTIC = "semantic"
    ORDERED = "ordered"
    DEPTH = "depth"
    DEPTH_CENTER = "depth_center"
    INSTANCE = "instance"
    LIDAR = "lidar"


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(OutputOptions, LocalFilterOptions):
    """Options of `unghost evaluate`."""

    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Lines of JSON with key, id and visible; else the frames' instance "
            "images tell: what has one pixel is visible.",
            exists=True,
            dir_okay=False,
        ),
    ] = None
    channel: Annotated[
        list[Channel] | None,
        typer.Option(help="A channel to compare; may be repeated. Else all."),
    ] = None
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.svg",
            help="Draw the F1 of each channel with its interval.",
            dir_okay=False,
        ),
    ] = None
    suggest: Annotated[
        bool,
        typer.Option(
            "--suggest",
            help="Suggest a threshold for each class from the same truth: the best F1, "
            "or with --recall the highest that keeps so much.",
        ),
    ] = False
    recall: Annotated[
        float | None,
        typer.Option(
            min=0.0001,
            max=1,
            help="With --suggest: the part of the visible objects to keep, 0 to 1.",
        ),
    ] = None
    config_out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.yaml",
            help="Write the configuration with the suggested thresholds.",
            dir_okay=False,
        ),
    ] = None


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "evaluate")(evaluate)


def evaluate(options: EvaluateOptions) -> None:
    """Compare the filter's channels with the truth, on a folder of frames.

    Precision, recall and F1 with 95 % intervals, ghosts kept and visible objects lost,
    for each channel; by class and by distance too; with --json the worst boxes, and
    with --suggest thresholds for each class with their curves. Exit code 3 if some
    frames could not be used; they are listed.
    """
    from filter_core.local import evaluate_source

    found = open_source(options.source, options)
    screen, task = options.screen, _task(options)
    thresholds = ThresholdsAsked.of(options, task.config)
    with screen.progress("evaluate", "frames") as advance:
        steps = iter(range(1, 1 << 62))
        evaluation, problems = evaluate_source(
            found,
            task,
            progress=lambda: advance(next(steps), found.count),
            also=thresholds.add,
            workers=options.workers,
        )
    for problem in problems:
        screen.note(f"refused: {problem['key']}: {problem['error']['detail']}")
    result = evaluation.as_dict()
    screen.record(result | thresholds.as_dict())
    print_evaluation(result, screen)
    thresholds.finish(screen)
    if options.plot is not None:
        options.plot.write_text(f1_plot(list(result["channels"].items())), "utf-8")
    if problems:
        raise typer.Exit(PARTLY if evaluation.frames else REFUSED)


def _task(options: EvaluateOptions) -> EvaluationTask:
    from filter_core.evaluation.comparison import COMPARED
    from filter_core.local import EvaluationTask, read_truth

    chosen = tuple(one.value for one in options.channel or ())
    return EvaluationTask(
        config=read_config(options.config, options, options.screen),
        truth=None if options.truth is None else read_truth(options.truth),
        channels=chosen or COMPARED,
    )


def print_evaluation(result: dict[str, Any], screen: Screen) -> None:
    """One table of the channels, one by distance and one by class."""
    channels = result["channels"]
    columns = ("channel", *_COLUMNS, "judged")
    rows = [(name, *_row(one), one["judged"]) for name, one in channels.items()]
    screen.table(columns, rows)
    for key, title in (("by_distance", "metres"), ("by_class", "class")):
        screen.table((title, "channel", *_COLUMNS), _parts(channels, key), tag=title)


def _parts(channels: dict[str, Any], key: str) -> Iterator[tuple[object, ...]]:
    parts = {name: dict(_named(one[key])) for name, one in channels.items()}
    names = dict.fromkeys(part for each in parts.values() for part in each)
    for part in names:
        for channel, each in parts.items():
            if part in each:
                yield part, channel, *_row(each[part])


def _named(parts: Any) -> Iterable[tuple[str, dict[str, Any]]]:  # noqa: ANN401  # JSON
    if isinstance(parts, dict):
        return parts.items()
    return [(one["band"], one) for one in parts]


def _row(score: dict[str, Any]) -> tuple[object, ...]:
    f1 = score["f1"] or {}
    shares = [
        (score["precision"] or {}).get("value"),
        (score["recall"] or {}).get("value"),
        *(f1.get(name) for name in ("value", "low", "high")),
    ]
    rounded = (None if one is None else round(one, 3) for one in shares)
    return (*rounded, score["kept_hidden"], score["rejected_visible"])
