"""`unghost evaluate`: the accuracy of each kind of evidence, on your own frames.

It prints tables, draws a chart, and suggests thresholds for each class.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final
from xml.sax.saxutils import escape

import typer

from unghost.cli import sources
from unghost.cli.options import OutputOptions, read_file, written_file
from unghost.cli.screen import ImageNotes, Kinds, Refused, Screen, partly_done, refusal
from unghost.cli.summary import LOOKED_AT
from unghost.wire.words import EvidenceName

if TYPE_CHECKING:
    from filter_core.config.filter import FilterConfig
    from filter_core.evaluation.comparison import EvaluationObject
    from filter_core.evaluation.scores import ConfusionObject, MeasuredObject
    from filter_core.evaluation.thresholds import Goal, Suggestion, TruthCollector
    from filter_core.local import KnownBoxes, Truth


_SCORE_COLUMNS: Final = (
    "precision",
    "recall",
    "F1",
    "low",
    "high",
    "ghosts kept",
    "visible lost",
)

_WIDTH, _ROW, _TITLES = 640, 34, 220
_TOP, _BOTTOM = 28, 46


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(OutputOptions, sources.LocalFilterOptions):
    truth: Annotated[
        Path | None,
        read_file(
            metavar="FILE",
            help="The ground truth: a line of JSON with key, id and visible for each "
            "box. Default: the frames' instance images, in which objects with a pixel "
            "are visible.",
        ),
    ] = None
    channel: Annotated[
        list[EvidenceName] | None,
        typer.Option(
            help="A kind of evidence to compare; may be repeated; default: all."
        ),
    ] = None
    plot: Annotated[
        Path | None,
        written_file(
            metavar="FILE.svg",
            help="Draw the F1 of each kind of evidence with its interval (SVG).",
        ),
    ] = None
    suggest: Annotated[
        bool,
        typer.Option(
            "--suggest",
            help="Suggest a threshold for each class by the ground truth: the one with "
            "the best F1, or with --recall the highest that reaches this recall.",
        ),
    ] = False
    recall: Annotated[
        float | None,
        typer.Option(
            min=0.0001,
            max=1,
            help="With --suggest: the share of visible objects to keep, 0 to 1.",
        ),
    ] = None
    config_out: Annotated[
        Path | None,
        written_file(
            metavar="FILE.yaml",
            help="With --suggest: write the configuration with the new thresholds.",
        ),
    ] = None


@sources.reads_archives
def evaluate(options: EvaluateOptions) -> None:
    """Compare the kinds of evidence with the ground truth, on a folder of frames.

    Precision, recall and F1 with 95 % intervals, ghosts kept and visible objects lost,
    for each kind of evidence, by class and by distance, too; with --json the worst
    boxes, and with --suggest thresholds for each class with their curves. Exit code 3
    if some frames could not be read, or some files or lines of the ground truth could
    not be matched.
    """
    from filter_core.evaluation.comparison import COMPARED
    from filter_core.local import EvaluationTask, evaluate_source, read_truth

    description = options.description_of(options.source)
    frames = sources.open_source(options.source, options.layout, description)
    screen = options.screen
    task = EvaluationTask(
        config=sources.read_config(options.config, options, description, screen),
        truth=None if options.truth is None else read_truth(options.truth),
        channels=tuple(options.channel or COMPARED),
    )
    first = islice(frames, LOOKED_AT)
    frames = sources.shown_by(first, task.config, task.channels, screen).of(frames)
    thresholds = _Thresholds.asked_for(options, task.config)
    use, notes = _TruthUse(task.truth), ImageNotes()

    def collect(boxes: KnownBoxes) -> None:
        use.add(boxes)
        if thresholds is not None:
            thresholds.add(boxes)

    done = 0
    with screen.progress("evaluate", "frames") as advance:

        def step(notes_of_frame: tuple[str, ...]) -> None:
            nonlocal done
            done += 1
            notes.add(notes_of_frame)
            advance(done, frames.count)

        evaluation, unusable = evaluate_source(
            frames, task, progress=step, also=collect, workers=options.workers
        )
    refusals = Kinds()
    left_out = [
        *(
            refusal(frame.key, sources.naming_reading(frame.problem.detail))
            for frame in unusable
            if refusals.is_listed(sources.kind_of(frame.problem))
        ),
        *refusals.more(),
        *sources.unmatched_lines(frames.unmatched),
        *use.unused_lines(),
    ]
    notes.print(screen)
    sources.note_reading(screen, frames)
    for line in (*left_out, *use.frames_without(done - len(unusable))):
        screen.note(line)
    if not evaluation.unfiltered.boxes:
        raise Refused("nothing was compared: the ground truth of no box is known")
    result = evaluation.as_dict()
    _print_evaluation(result, thresholds, screen)
    if options.plot is not None:
        scores = [(name, score["f1"]) for name, score in result["channels"].items()]
        label = "F1 of each kind of evidence with its 95 % interval"
        _write(options.plot, interval_plot(label, scores))
    if left_out:
        raise partly_done(evaluation.frames)


def _write(path: Path, text: str) -> None:
    from filter_core.formats.files import write_whole

    write_whole(path, text.encode())


class _TruthUse:
    """Which frames have a box of known truth, and which lines of a truth are used."""

    def __init__(self, truth: Truth | None) -> None:
        self._truth = truth or {}
        self._frames: set[str] = set()
        self._unused = sum(map(len, self._truth.values()))

    def add(self, boxes: KnownBoxes) -> None:
        """The boxes of one frame."""
        self._frames.add(boxes.key)
        if boxes.key in self._truth:
            self._unused -= len(boxes.ids)

    def frames_without(self, measured: int) -> Iterator[str]:
        """How many of the measured frames have no box of known truth, if any."""
        if without := measured - len(self._frames):
            yield f"frames without a box of known truth: {without} of {measured}"

    def unused_lines(self) -> Iterator[str]:
        """How many lines of the truth are about no box of the frames, if any."""
        if self._unused:
            example = next((key for key in self._truth if key not in self._frames), "")
            such = f", such as those of frame {example!r}" if example else ""
            yield f"lines of the ground truth about no box here: {self._unused}{such}"


def _print_evaluation(
    result: EvaluationObject, thresholds: _Thresholds | None, screen: Screen
) -> None:
    """Tables: of the kinds of evidence, by distance, by class, and of thresholds."""
    suggested = thresholds and [
        suggestion.as_dict() for suggestion in thresholds.suggested
    ]
    more = {} if suggested is None else {"suggested": suggested}
    screen.record({**result, **more})
    channels = result["channels"]
    columns = ("evidence", *_SCORE_COLUMNS, "measured")
    rows = [
        (name, *_score_row(score), score["judged"]) for name, score in channels.items()
    ]
    screen.table(
        columns, [("no filter", *_score_row(result["unfiltered"]), None), *rows]
    )
    by_distance = {
        name: {part["band"]: part for part in score["by_distance"]}
        for name, score in channels.items()
    }
    by_class = {name: score["by_class"] for name, score in channels.items()}
    for title, parts in (("metres", by_distance), ("class", by_class)):
        names = dict.fromkeys(part for each in parts.values() for part in each)
        of_parts = [
            (part, channel, *_score_row(each[part]))
            for part in names
            for channel, each in parts.items()
            if part in each
        ]
        screen.table((title, "evidence", *_SCORE_COLUMNS), of_parts, tag=title)
    if thresholds is not None:
        thresholds.print_and_write(screen)


def _score_row(score: ConfusionObject) -> tuple[object, ...]:
    precision, recall, f1 = score["precision"], score["recall"], score["f1"]
    shares = (
        precision and precision["value"],
        recall and recall["value"],
        f1 and f1["value"],
        f1 and f1["low"],
        f1 and f1["high"],
    )
    rounded = (None if share is None else round(share, 3) for share in shares)
    return (*rounded, score["kept_hidden"], score["rejected_visible"])


@dataclass
class _Thresholds:
    """Suggested thresholds: collects boxes, then prints and writes the thresholds."""

    collector: TruthCollector
    goal: Goal
    file: Path | None

    @classmethod
    def asked_for(
        cls, options: EvaluateOptions, config: FilterConfig
    ) -> _Thresholds | None:
        """Made from the options of the command line; None without `--suggest`."""
        from filter_core.evaluation.thresholds import Goal, TruthCollector

        if options.suggest:
            goal = Goal() if options.recall is None else Goal("recall", options.recall)
            return cls(TruthCollector(config), goal, options.config_out)
        if options.recall is not None or options.config_out is not None:
            raise typer.BadParameter("--recall and --config-out need --suggest")
        return None

    def add(self, boxes: KnownBoxes) -> None:
        """Boxes of a frame."""
        self.collector.add(boxes.evidence, boxes.visible)

    @cached_property
    def suggested(self) -> list[Suggestion]:
        """A threshold for each class that has boxes of both kinds."""
        return self.collector.suggestions(self.goal)

    def print_and_write(self, screen: Screen) -> None:
        """Print the table, and write the file if one was requested."""
        rows = map(_threshold_row, self.suggested)
        columns = ("class", "current", "suggested", "low", "high", "F1 now", "F1 then")
        screen.table(columns, rows, tag="threshold")
        if not self.suggested:
            screen.note(
                "no threshold can be suggested: no class has both visible and "
                "hidden boxes"
            )
        if self.file is not None:
            # The configuration of the evaluation with the new thresholds, as YAML
            import yaml

            from filter_core.evaluation.thresholds import with_thresholds

            plain = with_thresholds(self.collector.config, self.suggested).as_dict()
            _write(
                self.file, yaml.safe_dump(plain, sort_keys=False, allow_unicode=True)
            )
            screen.note(f"wrote {self.file}")


def _threshold_row(suggestion: Suggestion) -> tuple[object, ...]:
    scores = (suggestion.at_current.f1, suggestion.at_suggested.f1)
    return (
        suggestion.class_name,
        suggestion.at_current.threshold,
        suggestion.threshold,
        *(round(bound, 2) for bound in suggestion.interval),
        *(None if score is None else round(score, 3) for score in scores),
    )


def interval_plot(
    label: str, scores: Sequence[tuple[str, MeasuredObject | None]], step: float = 0.1
) -> str:
    """Values of 0 to 1 with their intervals, as an SVG document.

    `step` is between two ticks of the axis, which ends at the first tick above all
    intervals.
    """
    measured = [(title, score) for title, score in scores if score is not None]
    low = min((score["low"] for _, score in measured), default=0.0)
    high = max((score["high"] for _, score in measured), default=1.0)
    last = ceil(high / step)
    ticks = [step * number for number in range(last + 1) if step * number >= low - step]
    height = _ROW * len(measured) + _BOTTOM

    def x(value: float) -> float:
        share = (value - ticks[0]) / (ticks[-1] - ticks[0])
        return _TITLES + share * (_WIDTH - _TITLES - 30)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" '
        'font-family="system-ui, sans-serif" font-size="13" role="img" '
        f'aria-label="{escape(label)}">',
        f'<rect width="{_WIDTH}" height="{height}" fill="#ffffff"/>',
    ]
    for tick in ticks:
        parts += [
            f'<line x1="{x(tick):.1f}" x2="{x(tick):.1f}" y1="10" y2="{height - 30}" '
            'stroke="#d9dee3"/>',
            f'<text x="{x(tick):.1f}" y="{height - 12}" text-anchor="middle" '
            f'fill="#4a5560">{tick:.2g}</text>',
        ]
    for number, (title, score) in enumerate(measured):
        y = _TOP + _ROW * number
        parts += [
            f'<text x="{_TITLES - 12}" y="{y + 4}" text-anchor="end" fill="#1d2429">'
            f"{escape(title)}</text>",
            f'<line x1="{x(score["low"]):.1f}" x2="{x(score["high"]):.1f}" y1="{y}" '
            f'y2="{y}" stroke="#00735c" stroke-width="3"/>',
            f'<circle cx="{x(score["value"]):.1f}" cy="{y}" r="5.5" fill="#00735c"/>',
        ]
    return "\n".join([*parts, "</svg>\n"])
